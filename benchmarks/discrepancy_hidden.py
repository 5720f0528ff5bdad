"""Effects hidden where several instruments meet: joint networks, survey networks, mechanisms. Rates of what is found.

python benchmarks/discrepancy_hidden.py [--cases 30] [--clean 100] [--kind NAME ...] [--out benchmarks/results]

Cases are those of tests/discover_cases.py. They are written first, the truth into a folder of its own; the analysis
runs in another process that cannot open that folder. Effects are drawn among the candidates that each problem offers,
of a size (root mean square in u over the readings they change) at which the ideal test would miss one in a thousand.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from discover_cases import KINDS, judged, problem_of, seal, write

COLUMNS = ("kind", "hidden", "size", "cases", "alarm", "detected", "one_of_them", "all_or_alias_set", "exact",
           "exact_where_separable", "within_2u", "rms_before", "rms_after", "seconds")
FIRST = 3_000  # seed of the first case; nothing was tuned on these
HIDDEN = ((0, 0.0), (1, 1.0), (1, 3.0), (1, 10.0), (2, 3.0))


def lay(kinds: Iterable[str], clean: int, cases: int, folder: Path) -> None:
    """Write cases and truths below a folder."""
    for name in ("cases", "truths"):
        (folder / name).mkdir()
    for kind in kinds:
        for count, size in HIDDEN:
            for seed in range(FIRST, FIRST + (cases if count else clean)):
                write(kind, seed, count, size, folder / "cases", folder / "truths")


def analyse(folder: Path) -> None:
    """Explain every case; the truths are out of reach."""
    import calib
    from calib.workflow.discrepancy.answer import answer

    seal(folder / "truths")
    for case in sorted((folder / "cases").glob("*.npz")):
        begin = time.process_time()
        try:
            found = answer(case.stem, calib.explain(problem_of(case)))
        except calib.errors.CalibrationError as error:
            found = {"verdict": f"refused: {error}", "effects": [], "rms": {"before": 0.0, "after": 0.0}}
        found["seconds"] = time.process_time() - begin
        case.with_suffix(".answer.json").write_text(json.dumps(found), encoding="utf-8")


def lines(folder: Path) -> Iterable[list[object]]:
    """One line of the table for each kind and what was hidden."""
    read = [(json.loads(path.read_text()), json.loads((folder / "cases" / f"{path.stem}.answer.json").read_text()))
            for path in sorted((folder / "truths").glob("*.json"))]
    for kind in KINDS:
        for count, size in HIDDEN:
            chosen = [(t, a) for t, a in read if t["kind"] == kind and len(t["effects"]) == count
                      and (not count or t["size"] == size)]
            if not chosen:
                continue
            found = [judged(t, a) for t, a in chosen]
            separable = [f.exact for (t, _), f in zip(chosen, found, strict=True) if t["separable"]]
            within = [w for f in found for w in f.within_2u]
            rates = [np.mean([f.alarmed for f in found]), np.mean([f.verdict == "effects" for f in found]),
                     *([np.mean([f.any_of_them for f in found]), np.mean([f.all_or_alias for f in found]),
                        np.mean([f.exact for f in found]), np.mean(separable) if separable else np.nan,
                        np.mean(within) if within else np.nan] if count else [np.nan] * 5),
                     *np.median([f.rms for f in found], axis=0), np.median([a["seconds"] for _, a in chosen])]
            yield [kind, count, size, len(chosen), *("" if np.isnan(r) else f"{r:.3f}" for r in rates)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clean", type=int, default=100)
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--kind", nargs="*", default=list(KINDS))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--analyse", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--keep", type=Path, help="folder in which cases, truths and answers stay")
    chosen = parser.parse_args()
    if chosen.analyse:
        analyse(chosen.analyse)
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.keep or Path(temporary)
        folder.mkdir(exist_ok=True)
        lay(chosen.kind, chosen.clean, chosen.cases, folder)
        subprocess.run([sys.executable, __file__, "--analyse", str(folder)], check=True)
        with (chosen.out / "discrepancy_hidden.csv").open("w", newline="", encoding="utf-8") as stream:
            table = csv.writer(stream)
            table.writerow(COLUMNS)
            for row in lines(folder):
                table.writerow(row)
                print(*row, sep="\t", flush=True)


if __name__ == "__main__":
    main()
