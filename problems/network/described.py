"""What a job of a network may hold: tables with their columns, instruments, options; `calib problems network`."""

from __future__ import annotations

from problems.network.reduction import LEAVE_OUT

_READ = {"station, target": "names of points", "reading": "in a unit of its kind",
         "u": "standard uncertainty (else that of the instrument)"}
_HEIGHTS = {"station_height, target_height": "of instrument and target above the points (0 if not given)"}


def _covariance(parts: str, first: str) -> dict[str, str]:
    """How the uncertainty of readings of several components is stated."""
    u = ", ".join(f"u_{part}" for part in parts.split())
    pairs = [f"r_{a}{b}" for i, a in enumerate(parts.split()) for b in parts.split()[i + 1 :]]
    return {"u": f"of each component; or {u} with correlations {', '.join(pairs)}; or for the whole table covariance = "
                 f"\"FILE.csv\" in its [data.NAME]: a square table with the columns {first} or ROW.{parts.split()[0]} "
                 "[mm^2] ..."}


columns = {
    "points": {"point": "its name",
               "x, y, z": "coordinates, in the frame of the point; start values where it is adjusted (may be empty)",
               "role": "fixed, adjusted, or constrained (its start defines a free datum); adjusted if not given",
               "frame": "the frame that it belongs to; empty for the network"},
    "distances": _READ,
    "slope_distances": _READ | _HEIGHTS,
    "scale_bars": {"station, target": "names of the two marks", "reading": "calibrated length", "u": _READ["u"]},
    "directions": _READ | {"set": "setting of the circle (one each station if not given)",
                           "face": "1 or 2; readings of face 2 as reduced to face 1"},
    "angles": _READ | {"back": "backsight, from which the angle turns to the target"},
    "azimuths": _READ | {"reading": "from north in the sense of the circles"},
    "zenith_angles": _READ | _HEIGHTS | {"face": "1 or 2, as of directions"},
    "inclinations": _READ | _HEIGHTS | {"reading": "of the line to the target against the horizontal, up positive"},
    "height_differences": _READ,
    "vectors": {"station, target": "names of points", "dx, dy, dz": "differences of coordinates"}
    | _covariance("dx dy dz", "STATION-TARGET.dx [mm^2] ..."),
    "coordinates": {"station": "name of the point", "x, y, z": "observed"} | _covariance("x y z", "POINT.x [mm^2] ..."),
    "plane_coordinates": {"station": "name of the point", "x, y": "observed"}
    | _covariance("x y", "POINT.x [mm^2] ..."),
    "heights": {"station": "name of the point", "reading": "its height z", "u": _READ["u"]},
    "tracker": {"station, target": "of a laser tracker with six degrees of freedom",
                "range, azimuth, zenith": "readings; the instrument gives u_range, u_angle or u_across (a length "
                "across the beam, as \"15 um + 6 um/m\"), and levelled = true where its axis is vertical"},
    "ranges": {"instrument, target": "of an interferometer whose base point and dead path are unknown",
               "reading": "its length; the instrument gives u and counts (lengthening or shortening)"},
    "tilts": {"station or frame": "of an inclinometer: a tracker, or a frame",
              "along_x, along_y": "how far its axes x and y rise above the horizontal; the instrument gives u"},
    "frames": {"frame": "name of a body that moves rigidly; its points have coordinates in it",
               "x, y, z, rx, ry, rz": "where it stands: shifts and turns about the fixed axes of its parent, x first, "
               "then y, then z; exact, or start values of what is free (0 if not given)",
               "free": "those of the six that are unknown, as \"rz\" or \"x y rz\"; empty where it does not move",
               "epoch": "in which it stands there; readings then say their epoch in a column of this name",
               "parent": "frame around it, such as one whose z is an axis of rotation that is itself unknown"},
    "any of them": {"time, temp": "when it was read and how warm it was; drifts and thermal effects can then be found",
                    "block": "a number that grows where something was set up anew",
                    "epoch": "of the frames that its points belong to"},
    "any name": {"kind": "a key of [data.NAME]: which of these tables it is like, for a second instrument of one kind"},
}
options = {"axes": "directions of x and y: ne (default), en, sw, ...",
           "circles": "clockwise (default) or counterclockwise",
           "reference_temperature": "from which temperatures count (20 °C if not given)",
           "network": "a .gkf file beside the job, in place of tables",
           "free": "constants of instruments to estimate, as [\"zero_offset\", \"refraction\"] (`calib effects JOB` "
                   "lists them); what is known of one is a [[priors]] on it (on one that is not free: its "
                   "considered uncertainty)",
           "leave_out": "what may be left out so that the rest is adjusted, each remarked: any of "
                        + "; ".join(f"{name} ({text})" for name, text in LEAVE_OUT.items()),
           "leave_out_weak": "true for leave_out = [\"lacking\"]"}
