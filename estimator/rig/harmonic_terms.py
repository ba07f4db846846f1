"""Names of solid harmonics and of the amplitudes that a rig holds for them."""

from __future__ import annotations

HIGHEST_DEGREE = 20  # 440 amplitudes, still free of divergence and curl to 1e-12 of the field


def terms(degree: int) -> tuple[str, ...]:
    """Names of the 2 l + 1 terms of a degree: cosines and sines of m times the angle about z.

    Examples:
        >>> terms(2)
        ('cos0', 'cos1', 'sin1', 'cos2', 'sin2')
    """
    return ("cos0", *(f"{wave}{m}" for m in range(1, degree + 1) for wave in ("cos", "sin")))


def amplitude_key(degree: int, term: str) -> str:
    """Key of an amplitude of a coil, in tesla per ampere.

    Examples:
        >>> amplitude_key(1, "cos0")
        'degree1_cos0_T_per_A'
    """
    return f"degree{degree}_{term}_T_per_A"
