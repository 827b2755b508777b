"""Scenarios that are made, checked and drawn from Python."""

import json
import shutil
import subprocess
import xml.dom.minidom

import pytest

import iwol_sumo
from iwol_sumo import scenario


def test_a_new_scenario_is_checked_drawn_and_played(tmp_path):
    file = scenario.new("mine", "tee", agents=4, root=tmp_path)
    assert file == tmp_path / "scenarios" / "mine.xml" and file.exists()
    checked = scenario.check(file, steps=200)
    assert checked.ok, checked.findings
    assert checked.trial["agents"] == 4 and checked.trial["steps"] == 200
    assert xml.dom.minidom.parseString(scenario.show(file)).documentElement.tagName == "svg"
    assert "<table" in scenario.show(file, format="html")
    with iwol_sumo.parallel_env(file) as env:
        assert len(env.reset()[0]) == 4
    # A net is imported as well.
    net = next((tmp_path / "sumo_nets").rglob("mine.net.xml"))
    imported = scenario.import_net(net, "again", agents=2, root=tmp_path)
    assert imported.scenario.exists() and imported.candidates[0].arms == 3
    assert scenario.check(imported.scenario, steps=0).ok


def test_findings_are_objects_with_places(tmp_path):
    shutil.copytree(iwol_sumo.scenario_file("intersection").parents[1], tmp_path / "data")
    file = tmp_path / "data" / "scenarios" / "intersection.xml"
    file.write_text(file.read_text().replace("<termination horizon=", "<termination horizont="))
    checked = scenario.check(file)
    assert not checked.ok and checked.trial is None
    [found] = checked.errors
    assert (found.severity, found.file) == ("error", file) and found.line > 1 and found.column > 1
    assert "horizont" in found.message and str(found).startswith(f"{file}:{found.line}:{found.column}: error: ")
    if shutil.which("iwol"):
        out = subprocess.run(["iwol", "scenario", "check", file, "--json"], capture_output=True, text=True)
        [row] = json.loads(out.stdout)["findings"]
        assert (row["line"], row["message"], row["hint"]) == (found.line, found.message, found.hint)


def test_mistakes_are_exceptions(tmp_path):
    poor = tmp_path / "poor.osm"
    poor.write_text("<osm version='0.6'/>")
    scenario.new("other", "tee", root=tmp_path / "other")
    [net] = (tmp_path / "other").rglob("*.net.xml")
    for call, message in [
        (lambda: scenario.new("mine", "cros", root=tmp_path), "there is no template `cros`; choose one of cross, "),
        (lambda: scenario.new("mine", "cross", lanes=9, root=tmp_path), "^lanes 9: allowed: 1 to 4"),
        (lambda: scenario.new("my scenario", "cross", root=tmp_path), "not a valid name"),
        (lambda: scenario.import_osm(tmp_path / "none.osm", "mine", root=tmp_path), "none.osm"),
        (lambda: scenario.import_osm(poor, "mine", root=tmp_path), "import_osm takes an extract .* import_net takes a SUMO net"),
        (lambda: scenario.import_net(net, "mine", junction="none", root=tmp_path), "another id with junction, or leave the"),
        (lambda: scenario.import_sumocfg(tmp_path / "none.sumocfg", "mine", root=tmp_path), "none.sumocfg"),
        (lambda: scenario.check("intersecton"), "did you mean 'intersection'"),
        (lambda: scenario.check("intersection", 400), "4 to 48"),
        (lambda: scenario.show("intersection", format="png"), "allowed: 'svg', 'html'"),
        (lambda: scenario.new("mine", "cross", lanes=-1, root=tmp_path), "^lanes is -1; allowed: whole numbers"),
        (lambda: scenario.new("mine", "cross", agents=2**40, root=tmp_path), "^agents is 1099511627776; allowed"),
        (lambda: scenario.import_osm(poor, "mine", agents=-1, root=tmp_path), "^agents is -1; allowed"),
        (lambda: scenario.import_net(net, "mine", agents=2.5, root=tmp_path), "^agents is 2.5; allowed"),
        (lambda: scenario.import_sumocfg(poor, "mine", agents=-1, root=tmp_path), "^agents is -1; allowed"),
        (lambda: scenario.check("intersection", steps=-1), "^steps is -1; allowed"),
        (lambda: scenario.check("intersection", seed=-1), "^seed is -1; allowed"),
        (lambda: scenario.show("intersection", agents=-1), "^agents is -1; allowed"),
    ]:
        with pytest.raises(iwol_sumo.ScenarioError, match=message):
            call()
    assert not any((tmp_path / folder).exists() and any((tmp_path / folder).iterdir()) for folder in ("scenarios", "sumo_nets"))
