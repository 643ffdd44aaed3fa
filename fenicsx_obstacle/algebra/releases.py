"""Differences between the releases and builds of PETSc."""

from __future__ import annotations

from petsc4py import PETSc

_reasons = PETSc.SNES.ConvergedReason
NOT_A_NUMBER = getattr(_reasons, "DIVERGED_FNORM_NAN", None) or _reasons.DIVERGED_FUNCTION_NANORINF
"""SNES's reason for a residual that is infinite or not a number."""
LONGEST_STEP = f"snes_linesearch_max{'step' if PETSc.Sys.getVersion() < (3, 24) else 'lambda'}"
"""The option for the longest step of a line search."""
AMG = "hypre" if PETSc.Sys.hasExternalPackage("hypre") else "gamg"
"""Algebraic multigrid: BoomerAMG, or PETSc's own if PETSc was built without hypre, as for the wheels of PyPI."""
