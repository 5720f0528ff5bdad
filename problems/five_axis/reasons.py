"""Why a recomputed number differs from the printed one, and what the signs of the results mean in the room."""

from __future__ import annotations

_YAW = "rounding of the yaw reading T1 S3, 39.44 arcsec printed and used as 39"
_INDEX_S2 = (
    "T1 S2: the readings give 06.24 arcsec, 07 is printed; no change of a single digit of a reading gives 07, and the "
    "paper's own -0.227 mm of section 5.1 needs 06"
)
_D_Z = (
    "a digit, no rounding of intermediates: 1280 tan(-18.875 arcsec) = -0.117 mm, printed and used on as -0.177; it "
    "falsifies eq (9), z2 and item 4 (-0.086 instead of -0.169 mm)"
)
_CIRCLES = "with circles of the usual make (clockwise, zenith angles, index 90d00m16s), which the paper does not state"

WHY = {
    "T1_S2_hz": _INDEX_S2,
    "dX_ang": f"rounding of 39.44 to 39 and the printed 07 for 06.24: in full -33.2 arcsec. {_INDEX_S2}",
    "dX": (
        "rounding of 39.44 to 39 and the printed 07 for 06.24: -33.2 arcsec give -0.228 mm, the printed -32 arcsec "
        "-0.220. Section 5.1 uses -0.227 mm for the same quantity, so the paper contradicts itself. Called X there, it "
        "is Y of the frame of section 1: T1 looks along X"
    ),
    "yaw2_y": (
        "rounding of the two yaw readings to 06 and 39 arcsec: -33 arcsec give -0.227; with the printed 07 it would be "
        "the -0.220 of section 4 (printed as tan(158d29m07s - ...), where 185d is meant)"
    ),
    "A_y": _YAW,
    "B_y": f"{_YAW}, and of B to 14.8",
    "C_y": _YAW,
    "E_y": _YAW,
    "F_y": _YAW,
    "B_z": "rounding of the vertical centre of B, 8.05 arcsec, to 8",
    "C_z": "935 tan(-6.75 arcsec) = -0.0306 mm, printed as -0.030: cut off, not rounded",
    "D_y": (
        "full precision gives -0.0803; the paper's own 26.5 - 39 arcsec give -0.0776, so -0.079 follows from neither; "
        "no common yaw reading gives the printed A, C and D together; the cause is not in the paper (-0.079 is also "
        "the printed y of A)"
    ),
    "D_z": _D_Z,
    "l9_dz": _D_Z,
    "z2": _D_Z,
    "it4": _D_Z,
    "l8_dy": f"{_YAW}: both ends shift, the far one more",
    "l9_y0": (
        "a sign: eq (9) prints y + 0.007, while the point C of the text has y = +0.007, so y - 0.007 is meant; "
        "y2 = -0.113 was computed with +0.007. At full precision it is 0.0054 (rounding of the yaw reading)"
    ),
    "l10_dy": f"{_YAW}: both ends shift, the far one more",
    "y1": _YAW,
    "y2": _YAW,
    "y3": _YAW,
    "it3": _YAW,
    "it5": _YAW,
    "z1": "rounding of the vertical centres of A and B and of z to 0.001 mm (-0.06548 against -0.066)",
    "it6": (
        "arctan(-0.106/1800) = -12.1 arcsec along the printed numbers and at full precision; -11.8 follows from "
        "neither. It would follow from -0.106/1852.5, the distance of B in place of the difference 1800: a conjecture"
    ),
    "it7": "a sign: the printed -0.227 + 0.261 is +0.034; at full precision +0.036",
    "it9a": (
        "rounding of 39.44 to 39 and the printed 07 for 06.24: -33.2 arcsec give -0.228 mm, the printed 07 - 39 give "
        "-0.220, and section 5.1 uses -0.227 for the same offset"
    ),
    "ex_thA": (
        "a sign: -12.5 arcsec are -6.1e-5 rad, printed without the minus; at full precision the angle is -12.46 arcsec"
    ),
    "ex_thB": "a sign: -8.0 arcsec are -3.9e-5 rad, printed without the minus (and as 90d00m008s)",
    "ex_sigrad": "2.3 arcsec are 1.115e-5 rad; a digit is missing in 1.15e-5, which is 2.37 arcsec",
    "ex_prad": (
        "rounding of 2.3 arcsec to 1.15e-5 rad: with 2.3 arcsec it is 2.7e-5 rad = 5.6 arcsec; the printed 2.8e-5 rad "
        "is 5.8 arcsec and not the 5.6 printed beside it"
    ),
    "s3": (
        "wrong propagation, and rounding of 2.3 arcsec to 1.15e-5 rad: (15) is propagated as p (L - L_A) + L_A theta_A "
        "with p and theta_A as independent (16.0 um, with 1.15e-5 rad 16.5); the partial derivatives of (15) give "
        "11.7 um; and the 3.9 arcsec of the yaw reading, common to both ends, is left out: with it, see u of it3"
    ),
}

# How a printed uncertainty was found, where it agrees by the paper's own way and is still not the right one.
SIGMA = {
    "s1": (
        "the 1 arcsec of the index is put into each angle although it is common to both, and so enters p once: "
        "properly, see u of it1"
    ),
    "s2": "the 1 arcsec of the index is put into horizontal angles, which do not hold it: properly, see u of it2",
    "s4": "p and theta_A taken as independent, and the common index twice: properly, see u of it4",
    "s5": "p and theta_A taken as independent, the yaw reading (3.9 arcsec) left out: properly, see u of it5",
    "s6": "the common index enters each angle, as in s1; the u of E and F is assumed: properly, see u of it6",
    "s7": (
        "follows with the 3.9 arcsec of S3, which cancels in the difference, in place of the 2.9 arcsec of S2: "
        "identified from the printed number, not stated; properly, see u of it7"
    ),
    "s8": "eq (13), the u of both components of one axis together; that of the parallelism is u of lev_par",
    "s9a": (
        "the two filaments and a third term of 1 arcsec, identified from the printed 34 and 36 um; properly, see u of "
        "it9a"
    ),
    "s9b": (
        "the two filaments and a third term of 1 arcsec, identified from the printed 34 and 36 um; properly, see u of "
        "it9b"
    ),
    "s10": "p and theta_A taken as independent, and the common index twice: properly, see u of it10",
}

_LIES = {
    "it1": ("the end of the pitch axis away from T1 lies {side}, by {size:.1f} arcsec", "higher", "lower"),
    "it2": (
        "the roll axis, yaw turned by 90 degrees, points {side} of the pitch axis by {size:.1f} arcsec, seen from T1",
        "left", "right"),
    "it3": ("the pitch axis passes the yaw axis {side} by {size:.3f} mm, seen from T1", "left", "right"),
    "it4": ("the roll axis lies {side} than the pitch axis by {size:.3f} mm", "higher", "lower"),
    "it5": ("the roll axis passes the yaw axis {side} by {size:.3f} mm, seen from T1", "left", "right"),
    "it6": ("the end of the two-axis pitch axis away from T1 lies {side}, by {size:.1f} arcsec", "higher", "lower"),
    "it7": ("the two-axis yaw axis stands {side} of its pitch axis by {size:.3f} mm, seen from T1", "left", "right"),
    "it9a": (
        "the two-axis yaw axis stands {side} of the three-axis one by {size:.3f} mm, seen from T1", "left", "right"),
    "it9b": (
        "the two-axis yaw axis stands {side} of the three-axis one by {size:.3f} mm, seen from T2", "left", "right"),
    "it10": ("the two-axis pitch axis lies {side} than the three-axis one by {size:.3f} mm", "higher", "lower"),
}


def lies(key: str, value: float) -> str:
    """What a result means in the room, and what that assumes about the circles.

    key: of the item; value: in its printed unit. Returns a sentence, empty where there is nothing to say.
    """
    if key in ("it8a", "it8b"):
        return "about X and Y of the level's own frame at position 0; the paper does not say how it lies to T1"
    if key not in _LIES:
        return ""
    text, negative, positive = _LIES[key]
    sentence = text.format(side=negative if value < 0 else positive, size=abs(value))
    return f"{sentence}, {_CIRCLES}; otherwise the other way round"
