"""Files: names that tell them apart."""

from pathlib import Path

from calib import files


def test_files_of_different_names_need_no_folder():
    assert files.distinct_names([Path("/a/job.toml"), Path("/a/points.csv")]) == ["job.toml", "points.csv"]


def test_files_of_one_name_are_told_apart_by_the_nearest_folders_that_differ():
    first, second = Path("/data/first/survey/job.toml"), Path("/data/second/survey/job.toml")
    assert files.distinct_names([first, second]) == ["first/survey/job.toml", "second/survey/job.toml"]
    assert files.distinct_names([first, first]) == ["job.toml", "job.toml"]
