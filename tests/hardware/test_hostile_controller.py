"""A controller that says whatever its line can carry: one line for an error, and nothing grows without end."""

import re

import pytest
from scanrig.controllers.controller import Settings
from scanrig.controllers.grbl.lines import read_report, read_settings
from scanrig.controllers.jxs.controller import JxsController
from scanrig.errors import FirmwareError

from .fake import FakeController


@pytest.fixture
def fake():
    return FakeController()


@pytest.fixture
def controller(fake):
    one = JxsController(fake, fake.clock, session=1)
    one.hello()
    one.configure(Settings())
    one.enable(True)
    return one


@pytest.mark.parametrize("was", ["9" * 60, "1_000", "0x10", "1e3", "-"])
def test_a_number_that_no_firmware_has_is_one_line(fake, controller, was):
    tell = fake.tell
    fake.tell = lambda text: tell(re.sub("was=.*", f"was={was}", text))
    with pytest.raises(FirmwareError, match=r"says was=.* expected an integer") as problem:
        controller.home(30_000)
    assert len(str(problem.value)) < 200 and "\n" not in str(problem.value)


@pytest.mark.parametrize("said", ["nan", "inf", "1e400", "9" * 400, "1.2.3", "", "٣"])
def test_a_report_of_no_place_is_no_report(said):
    assert read_report(f"<Idle|MPos:{said},0.000,0.000|FS:0,0>") is None
    assert read_settings([f"$100={said}"]) == {}


def test_a_report_is_read():
    report = read_report("<Idle|MPos:-12.345,0.,3|FS:0,0>")
    assert report is not None and report.positions == (-12.345, 0.0, 3.0)
    assert read_settings(["$100=80.000", "$10=1"]) == {100: 80.0, 10: 1.0}
