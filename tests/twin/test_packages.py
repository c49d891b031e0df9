"""Packages of twins: what a missing one, or a missing library of the system, is answered with."""

import pytest

from nw_base.errors import PrerequisiteError
from nw_twin import packages


def test_open3d_starts_on_a_system_without_libusb():
    assert packages.package("open3d").geometry.TriangleMesh


def test_a_library_that_the_system_lacks_is_named_with_the_package_of_debian(monkeypatch):
    def fail(_):
        raise ImportError("libEGL.so.1: cannot open shared object file: No such file or directory")

    monkeypatch.setattr(packages, "import_module", fail)
    with pytest.raises(
        PrerequisiteError, match=r"needs a library of the system: libEGL\.so\.1"
    ) as e:
        packages.package("open3d")
    assert e.value.fix.startswith("on Debian and Ubuntu: apt-get install libegl1 libgl1 ")


def test_a_package_that_is_not_there_is_answered_with_the_extra(monkeypatch):
    def fail(_):
        raise ImportError("No module named 'pupil_apriltags'")

    monkeypatch.setattr(packages, "import_module", fail)
    with pytest.raises(PrerequisiteError) as e:
        packages.package("pupil_apriltags")
    assert e.value.fix == "pip install 'nw-eval[twin]'"
