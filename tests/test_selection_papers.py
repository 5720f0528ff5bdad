"""What the papers chose among redundant axes, targets and points, beside the best choice."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import calib
from calib import C, D
from calib.units import um
from problems import base_point_layout

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
import selection_axes as axes
import selection_layouts as layouts


def test_of_84_choices_of_six_axes_15_are_regular_and_none_of_the_others_is_chosen():
    rows, counts = axes.driving("initial")
    assert (counts["singular"], counts["nearly singular"], counts["regular"]) == (69, 0, 15) and len(rows) == 84
    assert [row["kind"] for row in rows[:15]] == ["regular"] * 15
    assert all(np.isnan(row["D"]) for row in rows if row["kind"] == "singular")
    _, counts = axes.driving("target")
    assert (counts["singular"], counts["nearly singular"], counts["regular"]) == (6, 63, 15)


@pytest.mark.parametrize("pose", ["initial", "target"])
def test_the_six_axes_of_the_paper_are_the_best_by_every_criterion_of_the_position(pose):
    rows, counts = axes.driving(pose)
    assert [counts[f"rank of the paper by {name}"] for name in ("D", "A (balls)", "E (balls)", "G (balls)")] == [1] * 4
    fit = calib.linearise(axes.nine_axes(axes.paper.part_poses()[pose]))
    best = calib.select(fit, 6, D(), by="group", method=calib.BranchAndBound())
    values = [row["D"] for row in rows if row["of the paper"]]
    assert best.value == pytest.approx(values[0], rel=1e-6) and best.proven


def test_a_singular_choice_of_axes_is_named_in_the_words_of_the_problem():
    fit = calib.linearise(axes.nine_axes(axes.paper.part_poses()["initial"]))
    request = axes.requested(fit, 6, D(), by="group")
    directions = request.candidates.unseen([0, 1, 3, 4, 6, 7])      # no Z axis at all
    assert directions and all("part" in one and "changes no reading" in one for one in directions)


def test_all_nine_axes_by_least_squares_are_better_than_any_six_in_every_component():
    for row in zip(*(tuple(line.values())[2:] for line in axes.against_nine("target"))):
        smallest, largest, of_the_paper, nine = row
        assert nine <= smallest * (1 + 1e-9) and smallest <= of_the_paper <= largest


def test_three_of_72_directions_reach_the_continuous_optimum_and_its_bound():
    for row in layouts.three_targets():
        assert row["sqrt(Q11 + Q22), discrete"] == pytest.approx(row["bound"], rel=1e-9)
        assert row["continuous (IPOPT)"] == pytest.approx(row["bound"], rel=1e-7)


def test_opposite_the_middle_of_the_travel_is_better_than_opposite_its_end_whatever_ten_points_are_taken():
    travel = np.column_stack([np.arange(1, 141) * 0.01, np.zeros(140)])
    for zero in (base_point_layout.TIED, base_point_layout.FREE):
        best = [calib.select(calib.linearise(base_point_layout.planar(travel, (foot, 0.5), zero, 1 * um)), 10,
                             C("base_point.x")) for foot in (0.7, 1.4)]
        # Even the bound of the end lies above what the middle reaches.
        assert best[1].bound > best[0].value


def test_the_best_layout_on_the_lines_of_the_experiment_is_half_as_good_again():
    for row in layouts.experiment_against_best():
        assert 1.4 < row["ratio"] < 1.6 and row["gap to the bound"] < 0.01


def test_after_two_lines_in_a_plane_the_next_best_point_lies_far_off_it():
    ranking = layouts.first_point()
    assert ranking[0]["place"] == "0.8 0.8 0.3 m"
