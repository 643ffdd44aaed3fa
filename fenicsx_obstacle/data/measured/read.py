"""Files of measured heights: columns of numbers, arrays, images, facets in space."""

from __future__ import annotations

import io
import re
import warnings
import zlib
from dataclasses import dataclass
from functools import lru_cache
from hashlib import file_digest
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.lib.format import open_memmap

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import counted, one_line

COLUMNS = (".csv", ".txt", ".dat", ".xyz")
ENDINGS = (*COLUMNS, ".npy", ".npz", ".png", ".stl")
MAX_BYTES = 2_000_000_000
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, eq=False)
class Heights:
    """Measured data of one of three kinds, from a file or from arrays.

    Attributes:
        columns: Points and heights, shape (n, 3), or (n, 2) along one axis.
        matrix: Heights of a grid, shape (rows along y, columns along x).
        x: Coordinates of the columns of the matrix, if they are known.
        y: Of its rows.
        triangles: Numbers of the points that are the corners of facets, shape (m, 3).
        image: Whether the matrix holds the parts 0 to 1 of a range.
    """

    columns: np.ndarray | None = None
    matrix: np.ndarray | None = None
    x: np.ndarray | None = None
    y: np.ndarray | None = None
    triangles: np.ndarray | None = None
    image: bool = False


def read(path: Path) -> Heights:
    """The data of a file; of one that was read last it is not read again.

    Raises:
        InputError: If it is missing, empty, broken, or of another kind.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(
                f"{path}: a {'folder' if path.is_dir() else 'pipe or device'}, not a file with measured data"
            )
        state = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):  # no file has a NUL in its name
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: measured data are in files that end in {', '.join(ENDINGS)}")
    if state.st_size == 0:
        raise InputError(f"{path}: is empty")
    if state.st_size > MAX_BYTES:
        raise InputError(
            f"{path}: {state.st_size / 1e9:.3g} GB, which is too large; the limit is {MAX_BYTES / 1e9:g} GB"
        )
    try:
        with path.open("rb") as file:
            content = file_digest(file, "sha256").digest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    return _read(path.resolve(), str(path), content)


@lru_cache(maxsize=8)
def _read(path: Path, name: str, content: bytes) -> Heights:
    """Read it; its content tells one state of a file from another, which its date does not."""
    reader = {".npy": _npy, ".npz": _npz, ".png": _png, ".stl": _stl}.get(path.suffix.lower(), _columns)
    try:
        return reader(path, name)
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {error.strerror or error}") from None


def _columns(path: Path, name: str) -> Heights:
    """Numbers between commas, semicolons, tabs or blanks; the first line may name the columns."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: not a text in UTF-8: byte {error.start} is none") from None
    first = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
    delimiter = next((sign for sign in (";", "\t", ",") if sign in first), None)
    if delimiter == ";":
        text, first = text.replace(",", "."), first.replace(",", ".")
    heads = [word.strip().strip('"').lower() for word in first.split(delimiter)]
    named = not any(_is_number(word) for word in heads)
    skipped = text[: text.index(first)].count("\n") + named if first else 0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # where there is no number
            found = np.loadtxt(io.StringIO(text), delimiter=delimiter, skiprows=skipped, ndmin=2)
    except ValueError:
        found = _slowly(text, delimiter, skipped, name)
    if not found.size:
        raise InputError(f"{name}: holds no numbers")
    if named and {"x", "z"} <= set(heads) and len(heads) == found.shape[1]:
        wanted = [heads.index(head) for head in ("x", "y", "z") if head in heads]
        return Heights(columns=found[:, wanted])
    return Heights(columns=found) if found.shape[1] in (2, 3) else Heights(matrix=found)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _slowly(text: str, delimiter: str | None, skipped: int, name: str) -> np.ndarray:
    """Find the line that cannot be read; empty cells are not-a-numbers."""
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.partition("#")[0].strip()
        if number <= skipped or not bare:
            continue
        words = [word.strip() for word in bare.split(delimiter)]
        if rows and len(words) != len(rows[0]):
            raise InputError(
                f"{name}: line {number} has {counted(len(words), 'column')}, the lines before it {len(rows[0])}"
            )
        bad = next((word for word in words if word and not _is_number(word)), None)
        if bad is not None:
            raise InputError(f"{name}: line {number}: {bad!r} is no number")
        rows.append([float(word) if word else np.nan for word in words])
    return np.array(rows)


def _npy(path: Path, name: str) -> Heights:
    try:
        with np.errstate(over="ignore"):
            found = open_memmap(path, mode="r")  # rejects a head that claims more bytes than there are
    except (ValueError, EOFError, TypeError, SyntaxError, TokenError, RecursionError) as error:
        raise InputError(f"{name}: not a NumPy file: {one_line(str(error)) or 'broken'}") from None
    return _of_array(found, name)


def _of_array(found: np.ndarray, name: str) -> Heights:
    if found.dtype.kind not in "iuf" or found.ndim != 2:
        got = f"{found.ndim} axes of {found.dtype}"
        raise InputError(f"{name}: holds an array with {got}: expected numbers, shape (n, 3) or (rows, columns)")
    found = found.astype(np.float64)
    return Heights(columns=found) if found.shape[1] in (2, 3) else Heights(matrix=found)


def _npz(path: Path, name: str) -> Heights:
    try:
        with ZipFile(path) as archive:
            large = [one.filename for one in archive.infolist() if one.file_size > MAX_BYTES]
            if large:
                raise ValueError(f"{large[0]} has more than {MAX_BYTES / 1e9:g} GB")
        with np.load(path, allow_pickle=False) as arrays:
            held = arrays.files
            found = {key: arrays[key] for key in held if key in ("x", "y", "z") or len(held) == 1}
            if not all(isinstance(array, np.ndarray) for array in found.values()):
                raise ValueError(f"{', '.join(found)}: no arrays in NumPy's format")
    except (ValueError, TypeError, SyntaxError, TokenError, RecursionError, EOFError, MemoryError, BadZipFile,
            NotImplementedError, RuntimeError, zlib.error) as error:  # fmt: skip
        raise InputError(f"{name}: not a NumPy archive: {one_line(str(error)) or 'broken'}") from None
    if "z" not in found:
        if len(held) == 1:
            return _of_array(found[held[0]], name)
        raise InputError(f"{name}: has no array z; it holds {', '.join(held) or 'none'}")
    return of_arrays(found.get("x"), found.get("y"), found["z"], name)


def numbers(values: Any) -> np.ndarray:
    """An array of numbers; where it is masked, of none: not-a-number."""
    return np.ma.filled(np.asanyarray(values, dtype=np.float64), np.nan)


def of_arrays(x: object, y: object, z: object, name: str) -> Heights:
    """From arrays x, y, z: axes and a matrix, or the coordinates of each height; x alone along one axis.

    Raises:
        InputError: If their shapes do not fit together.
    """
    try:
        xs, ys, heights = (None if one is None else numbers(one) for one in (x, y, z))
    except (TypeError, ValueError):
        raise InputError(f"{name}: x, y and z must be arrays of numbers") from None
    assert heights is not None
    given = [one for one in (xs, ys) if one is not None]
    if xs is not None and all(one.shape == heights.shape for one in given):
        return Heights(columns=np.column_stack([one.ravel() for one in (*given, heights)]))
    if heights.ndim == 2 and (not given or (len(given) == 2 and all(one.ndim == 1 for one in given))):
        return Heights(matrix=heights, x=xs, y=ys)
    shapes = ", ".join(
        f"{key} {one.shape}" for key, one in zip("xyz", (xs, ys, heights), strict=True) if one is not None
    )
    raise InputError(f"{name}: shapes do not fit: {shapes}; z has shape (len(y), len(x)), or all have the same")


def _png(path: Path, name: str) -> Heights:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            if image.mode not in ("1", "L", "I;16", "I;16B", "I"):
                image.load()
                grey = np.asarray(image.convert("RGB"), dtype=np.float64)
                if np.ptp(grey, axis=2).max() > 0:
                    raise InputError(f"{name}: a colour image; a grey one is needed")
                values, most = grey[..., 0], 255
            else:
                values = np.asarray(image, dtype=np.float64)
                most = {"1": 1, "L": 255}.get(image.mode, 65535)
    except Image.DecompressionBombError as error:
        raise InputError(f"{name}: too large: {error}") from None
    except (UnidentifiedImageError, SyntaxError, ValueError) as error:
        raise InputError(f"{name}: no image: {error}") from None
    return Heights(matrix=values[::-1] / most, image=True)  # the first row of an image is its top


def _stl(path: Path, name: str) -> Heights:
    """Facets of a binary or text file; their corners that are the same become one point."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + count * _FACET.itemsize and count:
        corners = np.frombuffer(data, _FACET, count, 84)["corners"].reshape(-1, 3).astype(np.float64)
    else:
        number = rb"\s+([-+.\deE]+)"
        found = re.findall(rb"vertex" + 3 * number, data)
        try:
            corners = np.array([[float(word) for word in one] for one in found]).reshape(-1, 3)
        except ValueError:
            corners = np.empty((0, 3))
        if not len(corners) or len(corners) % 3:
            raise InputError(f"{name}: not a complete STL file: its facets cannot be read")
    points, index = np.unique(corners, axis=0, return_inverse=True)
    return Heights(columns=points, triangles=index.reshape(-1, 3))
