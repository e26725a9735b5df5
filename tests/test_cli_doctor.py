"""The verb ``doctor`` on a whole and on a broken installation."""

import json
from importlib import metadata
from importlib.metadata import PackageNotFoundError

import pytest
from typer.testing import CliRunner

from cli.extras import COSTS
from cli.main import app


def run_doctor(*options):
    return CliRunner().invoke(app, ["doctor", *options])


def test_everything_the_tests_need_is_found_and_every_remedy_is_named():
    answer = json.loads(run_doctor("--json").stdout)
    assert answer["ok"]
    by_name = {one["name"]: one for one in answer["findings"]}
    assert by_name["packages"]["ok"] and by_name["extra train"]["ok"] and by_name["PCL"]["ok"]
    assert all(one["remedy"] and one["cost"] for one in answer["findings"] if not one["ok"])


def test_every_extra_is_known_to_doctor():
    import tomllib
    from pathlib import Path

    project = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]
    assert set(project["optional-dependencies"]) - {"dev", "fuzz"} == set(COSTS)


def test_a_missing_and_an_old_package_are_named_with_what_they_cost(monkeypatch):
    real = metadata.version

    def version(name):
        if name == "anny":
            raise PackageNotFoundError(name)
        return "2.0.0" if name == "torch" else real(name)

    monkeypatch.setattr(metadata, "version", version)
    shown = run_doctor().stdout
    assert "no anny" in shown and "no new bodies" in shown and "annotate-cloud[bodies]" in shown
    assert "torch==2.13.0 but 2.0.0" in shown
    assert json.loads(run_doctor("--json").stdout)["ok"]


@pytest.mark.parametrize("name", ["numpy", "numba"])
def test_without_a_needed_package_nothing_is_ok(monkeypatch, name):
    real = metadata.version
    monkeypatch.setattr(metadata, "version", lambda asked: "0.1" if asked == name else real(asked))
    assert not json.loads(run_doctor("--json").stdout)["ok"]
