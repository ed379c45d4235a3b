"""The folder of products belongs to one project, and to one batch at a time."""

import json
import os
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


@pytest.mark.parametrize("text", ["", '{"pid": 1', "1 on vm\n"])
def test_the_lock_of_a_batch_that_died_is_taken_over(museum, text):
    project = load_project(museum)
    with claimed(project):
        lock = project.output / ".batch.lock"
        assert json.loads(lock.read_text())["pid"] == os.getpid()
    assert not lock.exists()
    lock.write_text(text)
    with claimed(project):
        pass
    assert not lock.exists()
    lock.write_text('{"pid": 1, "host": "elsewhere", "start": "then"}')
    with pytest.raises(ConfigError, match=r"process 1 on elsewhere.*; if that one has ended, delete"), claimed(project):
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
