"""Numbers and names in texts."""

from __future__ import annotations

import csv
import difflib
import io
import math
import unicodedata
from collections.abc import Mapping, Sequence
from typing import Any

LISTED_PATCHES = 6  # separate contacts in a text
LISTED = 40  # known names in a message
SHOWN = 60  # characters of a value
LONGEST = 160  # characters of a title or name where it is shown
ROUND_OFF = 1e-12  # of the largest component of a vector
LEAST_ERROR = 1e-14  # of a value: smaller ones are below its last digit
LEAST_DIGIT = 1e-6  # of the last digit: round-off


def counted(number: int, noun: str) -> str:
    """A number with its noun: 1 step, 2 steps."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def of_outputs(words: str) -> str:
    """How far errors of output quantities are guaranteed, from the words of the error bound that they follow from: with
    sampled data they are estimated."""
    return words.replace("certified", "estimated" if " sampled " in words else "guaranteed", 1)


def one_line(text: str, longest: int = LONGEST) -> str:
    """A user's text in one line, without control or formatting characters, cut if it is long."""
    shown = "".join(" " if _is_control(character) else character for character in text[: 20 * longest])
    shown = " ".join(shown.split())
    return shown if len(shown) <= longest else shown[: longest - 4].rstrip() + " ..."


# what moves the cursor, changes colours or the order of what is read; lines and tabs stay
_NOT_PRINTED = {
    code: f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}"
    for code in (*range(32), *range(127, 160), 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A))
    if chr(code) not in "\n\t"
}


def printable(text: str) -> str:
    """A text whose control characters cannot reach a terminal: they are written as escapes."""
    return text.translate(_NOT_PRINTED)


def title_of(title: str, name: str) -> str:
    """The title of a scene, or its name where it has none, in one line."""
    return one_line(title) or one_line(name)


def _is_control(character: str) -> bool:
    """Whether it is a control or formatting character or a surrogate; what joins letters is none of them."""
    return unicodedata.category(character).startswith("C") and character not in "\u200c\u200d"


def plain(value: Any) -> str:
    """A number or formula as one writes it: 0 and not 0.0."""
    return f"{value:.15g}" if isinstance(value, float) else str(value)


def in_toml(value: Any) -> str:
    """A value of a scene as it stands there, in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {in_toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(in_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else plain(value)


def short(value: Any) -> str:
    """A number or formula in few characters."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def with_error(value: float, error: float, form: str = ".10g") -> str:
    """A value with its error: the error with two digits, rounded upwards together with what the value is rounded by;
    the value with no more decimals than the error has.

    Args:
        value: Finite.
        error: Not negative.
        form: Of the value where the error is 0, below round-off or not finite.
    """
    if not LEAST_ERROR * abs(value) < error < math.inf:
        return f"{value:{form}} +- {error:.2g}"
    last = _exponent(error) - 1  # the power of ten of the last digit
    rounded = round(value, -last)
    error = math.ceil((error + abs(value - rounded)) / 10.0**last - LEAST_DIGIT) * 10.0**last
    first = max(_exponent(value), last + 1) if value else last + 1
    if -5 < first < 7:
        numbers = (round(number, -last) if last > 0 else number for number in (rounded, error))
        return " +- ".join(f"{number:.{max(0, -last)}f}" for number in numbers)
    both = " +- ".join(f"{number / 10.0**first:.{first - last}f}" for number in (rounded, error))
    return f"({both})e{first:+03d}"


def _exponent(value: float) -> int:
    """The power of ten of the first of two rounded digits."""
    return int(f"{value:.1e}".partition("e")[2])


def vector_in_words(values: Sequence[float]) -> str:
    """A vector as one writes it, without the round-off of components that are 0."""
    largest = max(map(abs, values), default=0.0)
    return f"({', '.join(f'{x:.6g}' if abs(x) > ROUND_OFF * largest else '0' for x in values)})"


def patches_in_words(contact: Mapping[str, Any]) -> list[str]:
    """Force, area, peak and place of each separate contact of a body, the largest forces first; none of one contact."""
    patches = contact.get("patches", ())
    if len(patches) < 2:
        return []
    most = max(math.hypot(*one["force"]) for one in patches)
    listed = sorted(patches, key=lambda one: -round(math.hypot(*one["force"]) / most, 6))[:LISTED_PATCHES]
    words = [f"at ({', '.join(f'{x:.4g}' for x in one['at'])}): force {vector_in_words(one['force'])}, "
             f"area {one['area']:.6g}, peak {one['peak']:.6g}" for one in listed]  # fmt: skip
    return [*words, *([f"and {len(patches) - len(listed)} more"] if len(patches) > len(listed) else [])]


def nearest(word: str, known: Any) -> str:
    """A hint: the known word that is most similar to `word`, or a list of the known words."""
    alike = {name.lower(): name for name in sorted(known)}
    close = difflib.get_close_matches(word.lower(), alike, 1, 0.6)
    if close:
        return f"; did you mean '{alike[close[0]]}'?"
    if not known:
        return " (there are none)"
    names = sorted(known)
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return f" (known: {', '.join(names[:LISTED])}{more})"


def shown(value: Any) -> str:
    """A value, or its beginning, in one line."""
    import numpy as np  # only where a message shows a value

    text = " ".join(repr(value.item() if isinstance(value, np.generic) else value).split())
    return text if len(text) <= SHOWN else f"{text[:SHOWN]} ..."


def csv_of(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as text, a line each, with one head for all; None is empty."""
    text, heads = io.StringIO(), dict.fromkeys(key for row in rows for key in row)
    writer = csv.DictWriter(text, list(heads), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a table of words, each column as wide as its longest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
