"""Verdicts on published numbers: half of the last printed digit, ranges, sampling intervals."""

from __future__ import annotations

import json

import pytest

from calib.errors import DeclarationError
from calib.workflow.reproduce import Item, Printed, Reproduction, verdict


@pytest.mark.parametrize("text, half", [("-0.169", 5e-4), ("1400.9", 0.05), ("49e-6", 5e-7), ("1.52e-6", 5e-9),
                                        ("100", 0.5)])
def test_half_of_the_last_printed_digit_is_read_from_the_text(text, half):
    printed = Printed.of(text)
    assert printed.number == float(text)
    assert printed.half_digit == pytest.approx(half, rel=1e-15)


@pytest.mark.parametrize("value, words", [(-0.1694, "agrees"), (-0.1695, "agrees"), (-0.16951, "differs"),
                                          (0.169, "differs"), (None, "not determinable"),
                                          (float("nan"), "not determinable")])
def test_a_value_agrees_to_half_of_the_last_digit(value, words):
    assert verdict(value, Printed.of("-0.169")) == words


def test_a_value_agrees_with_a_printed_range_inside_it():
    assert verdict(6.6, Printed.of("6 to 7")) == "agrees"
    assert verdict(7.1, Printed.of("6 to 7")) == "differs"


def test_a_monte_carlo_number_agrees_within_its_sampling_interval():
    assert verdict(0.0283, Printed.of("0.0270")) == "differs"
    assert verdict(0.0283, Printed.of("0.0270"), sampling=0.0015) == "agrees"


def test_a_sign_that_cannot_be_observed_is_not_compared():
    assert verdict(228.9421, Printed.of("-228.9421"), magnitude=True) == "agrees"


def test_an_item_that_does_not_agree_must_say_why():
    with pytest.raises(DeclarationError, match="without a reason"):
        Item("k", "q", "mm", Printed.of("1.0"), value=2.0)
    with pytest.raises(DeclarationError, match="without a reason"):
        Item("k", "q", "mm", Printed.of("1.0"))


def test_where_only_the_rounded_path_agrees_rounding_is_the_reason():
    item = Item("k", "q", "mm", Printed.of("1.0"), value=1.2, rounded=1.0)
    assert item.verdict == "differs"
    assert item.why.startswith("rounding of")


def test_the_file_holds_every_entry_of_the_format(tmp_path):
    items = [Item("k", "q", "mm", Printed.of("1.0", "mm"), value=1.01, u=0.1, joint_alternatives={"shared": 1.02})]
    content = json.loads(Reproduction("paper", tuple(items)).write(tmp_path).read_text())
    assert content["name"] == "paper"
    (entry,) = content["quantities"]
    assert list(entry)[:6] == ["key", "quantity", "unit", "printed", "printed_u", "value"]
    assert entry["verdict"] == "agrees"
    assert entry["joint"] is None
    assert entry["joint_alternatives"] == {"shared": 1.02}


def test_two_items_of_one_key_are_refused():
    item = Item("k", "q", "mm", Printed.of("1.0"), value=1.0)
    with pytest.raises(DeclarationError, match="two items of the key 'k'"):
        Reproduction("paper", (item, item))
