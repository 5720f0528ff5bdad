"""The geometry that was identified, as files for a controller: axes, Denavit-Hartenberg table, robot description."""

from __future__ import annotations

from calib.mechanism import table, tabulated, urdf
from calib.mechanism.chain import Mechanism
from calib.mechanism.identified import identified
from calib.solve.estimate import Estimate


def geometry_files(mechanism: Mechanism, estimate: Estimate, frame: str,
                   description: urdf.Description | None = None, base: str | None = None) -> dict[str, str]:
    """Files of the identified geometry, {name: text}: identified_axes.csv, identified_dh.csv, identified.urdf.

    mechanism: as designed; estimate: of a problem with its effects; frame: at the end of the chain of the table;
    description, base: where it was read from a URDF. What no geometry can hold (scales, harmonics, deflection) is named
    in the first line of each file.
    """
    values = {a.effect: estimate[a.effect] for a in estimate.problem.attached if not a.keys}
    found = identified(mechanism, values)
    left = [*found.left_out, *(a.effect.label for a in estimate.problem.attached if a.keys)]
    remark = "source: identified geometry, all axes at zero" + (
        f"; the controller must compensate by itself: {', '.join(left)}" if left else "")
    files = {"identified_axes.csv": tabulated.write_axes(found.mechanism, remark)}
    if mechanism.path(frame):
        files["identified_dh.csv"] = tabulated.write_table(table.standard(found.mechanism, frame), remark)
    if description is not None:
        files["identified.urdf"] = urdf.written(description, found.mechanism, base)
    return files
