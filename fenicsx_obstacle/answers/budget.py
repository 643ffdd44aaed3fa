"""`--budget`: limits of time, memory and unknowns."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from fenicsx_obstacle.errors import InputError

_UNITS = {"s": ("seconds", 1.0), "min": ("seconds", 60.0), "h": ("seconds", 3600.0), "MB": ("megabytes", 1.0),
          "GB": ("megabytes", 1e3), "unknowns": ("unknowns", 1.0)}  # fmt: skip


@dataclass(frozen=True)
class Budget:
    """Limits of a solve; inf means no limit.

    Attributes:
        seconds: Of the solve, all meshes together.
        megabytes: Peak memory of all ranks, in MB of 10^6 bytes.
        unknowns: On the finest mesh.
    """

    seconds: float = math.inf
    megabytes: float = math.inf
    unknowns: float = math.inf

    @classmethod
    def of(cls, text: str | None) -> Budget:
        """The budget in words: "60s", "8GB", "1e6 unknowns", or several with commas between.

        Raises:
            InputError: If it is none of these.
        """
        if text is None:
            return cls()
        limits: dict[str, float] = {}
        for part in text.split(","):
            match = re.fullmatch(r"\s*([0-9.]+(?:[eE][+-]?\d+)?)\s*([a-zA-Z]+)\s*", part)
            if match is None or match[2] not in _UNITS:
                raise InputError(f"--budget {text}: expected limits such as 60s, 10min, 8GB or '1e6 unknowns'")
            name, factor = _UNITS[match[2]]
            try:
                limits[name] = float(match[1]) * factor
            except ValueError:
                raise InputError(f"--budget {text}: {match[1]} is not a number") from None
            if not 0 < limits[name] < math.inf:
                raise InputError(f"--budget {text}: limits are positive and finite")
        return cls(**limits)
