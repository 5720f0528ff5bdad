"""Part on three 3-axis locators: poses from axis readings and a tracker, pose error, and the errors of the locators.

Source: Li Chen, Fang Qiang, Li Jiangxiong 2010, see `source`.
"""

from __future__ import annotations

from calib import Problem
from problems.locators.campaign import U_AXIS, U_TRACKER, drawn_poses, job_files, measure
from problems.locators.case import columns, formulations, from_job, options, remarks
from problems.locators.measured import Locator, Readings, Setup, declare
from problems.locators.pose_error import linear_form
from problems.locators.printed import reproduce
from problems.locators.scene import scene
from problems.locators.vocabulary import effects, error_functions

__all__ = [
    "Locator", "Readings", "Setup", "accepts", "columns", "declare", "effects", "error_functions", "example",
    "example_job",
    "formulations", "from_job", "linear_form", "options", "published", "remarks", "reproduce", "scene",
]

accepts = ("locators", "locator_pose")
published = "locators"
source = ("Li Chen, Fang Qiang, Li Jiangxiong, Error analysis of 3-axis locator based pose adjustment mechanism, 2010, "
          "article no. 1001-4551(2010)03-0006-08")


def example(seed: int) -> Problem:
    """Four poses of a part on three locators with a tracker on five targets, simulated; every named effect held.

    seed: of poses and noise.
    """
    campaign = measure(drawn_poses(4, seed), seed)
    return declare(campaign.setup, campaign.axes, campaign.targets, u_axis=U_AXIS, u_tracker=U_TRACKER)


def example_job(seed: int) -> dict[str, str]:
    """A runnable job: twelve poses in which locator A is out of square by 60 arcseconds.

    seed: of poses and noise. Returns {file name: text}.
    """
    return job_files(seed)
