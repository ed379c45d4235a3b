"""The folder of products belongs to one project, and to one batch at a time."""

import shutil

import pytest

from jaxscan.errors import ConfigError
from jaxscan.project import claimed, load_project


def test_one_batch_at_a_time(museum, run):
    project = load_project(museum)
    with claimed(project):
        with pytest.raises(ConfigError, match="another batch is writing here"), claimed(project):
            pass
        ran = run("batch", museum)
        assert ran.code == 1 and ran.err.count("\n") == 1 and "another batch is writing here" in ran.err
    with claimed(project):
        pass


def test_one_project_in_a_folder(museum, run):
    with claimed(load_project(museum)):
        pass
    other = museum.with_name("other.toml")
    shutil.copy(museum, other)
    ran = run("batch", other)
    assert ran.code == 1 and f"holds the products of another project, {museum}" in ran.err
    # A project that was moved is the same one.
    museum.unlink()
    with claimed(load_project(other)):
        pass


def test_an_error_of_the_work_is_not_taken_for_one_of_the_folder(museum):
    with pytest.raises(TimeoutError, match="of the work"), claimed(load_project(museum)):
        raise TimeoutError("of the work")
