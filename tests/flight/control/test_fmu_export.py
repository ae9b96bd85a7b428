"""What a functional mock-up unit says of itself, read without a tool of others."""

import zipfile
from xml.etree import ElementTree

import pytest
from testing.c_compiler import follower

from gnc_opt.control import export_fmu
from gnc_opt.control import fmu_export as fmu

DT = 0.1


@pytest.fixture(scope="module")
def controller():
    return follower()


def described(controller, folder, **options):
    unit = export_fmu(controller, folder / "law.fmu", dt=DT, binary=False, **options)
    with zipfile.ZipFile(unit.file) as archive:
        return unit, ElementTree.fromstring(archive.read("modelDescription.xml")), archive.namelist()


def test_a_unit_names_its_inputs_outputs_and_alarms(controller, tmp_path):
    unit, root, members = described(controller, tmp_path)
    assert root.attrib == {
        "fmiVersion": "2.0", "modelName": controller.name, "guid": unit.guid, "generationTool": "gnc_opt",
        "description": "Discrete-time control law", "variableNamingConvention": "flat",
    }  # fmt: skip
    assert len(unit.guid) == 32 and unit.identifier == "law" and unit.dt == DT and unit.binary is None
    simulation = root.find("CoSimulation")
    assert simulation.attrib == {
        "modelIdentifier": "law", "canHandleVariableCommunicationStepSize": "true", "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
    }  # fmt: skip
    sources = [file.get("name") for file in simulation.iterfind("SourceFiles/File")]
    assert sources == ["fmi2_cosimulation.c", "law.c"] and {f"sources/{name}" for name in sources} < set(
        members
    )
    assert [unit.get("name") for unit in root.iterfind("UnitDefinitions/Unit")] == ["1/s^2", "rad", "rad/s"]
    assert root.find("DefaultExperiment").attrib == {
        "stepSize": "0.1",
        "startTime": "0.5",
        "stopTime": "3.53",
    }
    variables = [(v.attrib, v[0].tag, v[0].attrib) for v in root.find("ModelVariables")]
    output = {"causality": "output", "variability": "discrete", "initial": "exact"}
    heard = {"causality": "input", "variability": "continuous"}
    assert variables == [
        ({"name": "q", "valueReference": "0", **heard}, "Real", {"start": "0.0", "unit": "rad"}),
        ({"name": "v", "valueReference": "1", **heard}, "Real", {"start": "0.0", "unit": "rad/s"}),
        ({"name": "a", "valueReference": "2", **output}, "Real", {"start": "0.0", "unit": "1/s^2"}),
        ({"name": "invalid", "valueReference": "0", **output}, "Boolean", {"start": "false"}),
    ]
    assert [u.get("index") for u in root.iterfind("ModelStructure/Outputs/Unknown")] == ["3", "4"]


@pytest.mark.parametrize(("limit", "bits"), [(2**63 - 1, "64"), (2**31 - 1, "32"), (2**32, "32")])
def test_folders_of_libraries_are_those_of_the_standard(monkeypatch, limit, bits):
    monkeypatch.setattr(fmu.sys, "maxsize", limit)
    for system, folder in (("linux", "linux"), ("win32", "win"), ("darwin", "darwin")):
        monkeypatch.setattr(fmu.sys, "platform", system)
        assert fmu._get_fmu_binary_folder() == folder + bits
