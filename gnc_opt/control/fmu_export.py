"""Export of a controller as a functional mock-up unit (FMU), FMI 2.0 for co-simulation.

The archive contains the C code of `export_c`, ``fmi2_cosimulation.c`` and, with a compiler, this platform's library.
"""

from __future__ import annotations

import hashlib
import math
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from gnc_opt.control.c_export.c_code_export import CCode, export_c, select_codegen_controller
from gnc_opt.control.discrete_time_controller import Controller
from gnc_opt.errors import ArgumentError, GncOptError
from gnc_opt.npz_result_files import open_for_atomic_write

_INTERFACE = Path(__file__).with_name("fmi2_cosimulation.c")
_LAW_HEADER = Path("fmu_law.h")
_FOLDERS = {"linux": "linux", "darwin": "darwin", "win32": "win"}
_SUFFIXES = {"linux": ".so", "darwin": ".dylib", "win32": ".dll"}
_SAME_DATE = (1980, 1, 1, 0, 0, 0)
"""Fixed time stamp of all archive members: the same controller gives identical files."""


@dataclass(frozen=True)
class Fmu:
    """Exported functional mock-up unit.

    Attributes
    ----------
    file : Path
    identifier : str
        Model identifier and name of the library.
    guid : str
    dt : float
        Control step, s.
    binary : str or None
        Folder of the compiled library (``"linux64"``); ``None`` if the unit contains sources only.

    Examples
    --------
    >>> unit = go.export_fmu(regulator, "regulator.fmu", binary=False)
    >>> print(unit.binary)  # sources only
    None
    """

    file: Path
    identifier: str
    guid: str
    dt: float
    binary: str | None


def export_fmu(
    controller: Controller,
    file: str | Path,
    *,
    dt: float | None = None,
    span: tuple[float, float] | None = None,
    binary: bool | None = None,
) -> Fmu:
    """Return the functional mock-up unit (FMI 2.0 for co-simulation) of a controller, written to a file.

    Inputs are the measured states, outputs the commands; both are Real with the names and units of the model. Alarms
    are Boolean outputs. ``fmi2DoStep(t, h)`` runs the control steps (start time plus multiples of dt) in [t, t + h).

    Parameters
    ----------
    controller : Controller
        See `export_c`.
    file : path
        ``<name>.fmu``; its stem is the model identifier. Missing folders are created.
    dt, span
        See `export_c`.
    binary : bool, optional
        Compile the library with ``cc``; default: only if a compiler is found.

    Raises
    ------
    ArgumentError
        The file name is not ``<C identifier>.fmu``, or `export_c` rejects the controller.
    GncOptError
        ``binary=True`` and the compiler is missing or fails.

    Source: Functional Mock-up Interface 2.0.4, Modelica Association (2022).

    Examples
    --------
    >>> unit = go.export_fmu(regulator, "regulator.fmu", binary=False)
    >>> print(unit.file.name, unit.identifier, unit.dt)
    regulator.fmu regulator 0.1
    """
    file = Path(file)
    if file.suffix != ".fmu":
        raise ArgumentError(f"a functional mock-up unit is a file '<name>.fmu', not '{file.name}'.")
    if file.stem in (_INTERFACE.stem, _LAW_HEADER.stem):
        raise ArgumentError(f"'{file.stem}' is a source file of every unit: use another name.")
    compiler = shutil.which("cc")
    if binary and compiler is None:
        raise GncOptError(
            "no C compiler (cc) is found: install one, or write sources only with binary=False."
        )
    with tempfile.TemporaryDirectory() as folder:
        sources = Path(folder)
        code = export_c(controller, sources, dt=dt, span=span, name=file.stem)
        controller = select_codegen_controller(controller).controller
        code.driver.unlink()
        shutil.copy(_INTERFACE, sources)
        guid = _hash_c_sources(sources)
        (sources / _LAW_HEADER).write_text(_write_fmu_c_header(controller, code, guid), encoding="ascii")
        members = {f"sources/{path.name}": path.read_bytes() for path in sorted(sources.iterdir())}
        members["modelDescription.xml"] = _write_fmu_model_description(controller, code, guid)
        place = None
        if compiler is not None and binary is not False:
            place = _get_fmu_binary_folder()
            name = code.name + _SUFFIXES[sys.platform]
            members[f"binaries/{place}/{name}"] = _compile_fmu_library(compiler, sources, code, name)
    file.parent.mkdir(parents=True, exist_ok=True)
    _write_fmu_archive(file, members)
    return Fmu(file, code.name, guid, code.dt, place)


def _hash_c_sources(sources: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(sources.iterdir()):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]


def _write_fmu_c_header(controller: Controller, code: CCode, guid: str) -> str:
    alarms = [controller.memory.slice(name).start for name in controller.alarms]
    return "\n".join(
        [
            f'#include "{code.name}.h"',
            f"#define LAW_START {code.name}_start",
            f"#define LAW_STEP {code.name}_step",
            f"#define LAW_DT {code.dt!r}",
            f"#define LAW_N_STATES {controller.states.size}",
            f"#define LAW_N_COMMANDS {controller.commands.size}",
            f"#define LAW_N_MEMORY {max(controller.memory.size, 1)}",
            f"#define LAW_N_ALARMS {len(alarms)}",
            f"#define LAW_ALARMS {{{', '.join(map(str, alarms or [0]))}}}",
            f'#define LAW_GUID "{guid}"',
            "",
        ]
    )


def _write_fmu_model_description(controller: Controller, code: CCode, guid: str) -> bytes:
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=controller.name,
        guid=guid,
        description="Discrete-time control law",
        generationTool="gnc_opt",
        variableNamingConvention="flat",
    )
    simulation = _add_xml_element(
        root,
        "CoSimulation",
        modelIdentifier=code.name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    sources = _add_xml_element(simulation, "SourceFiles")
    for name in (_INTERFACE.name, code.source.name):
        _add_xml_element(sources, "File", name=name)
    units = sorted({unit for unit in (*controller.states.units, *controller.commands.units) if unit})
    if units:
        definitions = _add_xml_element(root, "UnitDefinitions")
        for unit in units:
            _add_xml_element(definitions, "Unit", name=unit)
    _add_xml_element(
        root, "DefaultExperiment", stepSize=repr(code.dt), **_format_default_experiment_times(controller)
    )
    variables, structure = _add_xml_element(root, "ModelVariables"), _add_xml_element(root, "ModelStructure")
    _add_fmu_variables(controller, variables)
    outputs = _add_xml_element(structure, "Outputs")
    for index, variable in enumerate(variables, start=1):
        if variable.get("causality") == "output":
            _add_xml_element(outputs, "Unknown", index=str(index))
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def _format_default_experiment_times(controller: Controller) -> Mapping[str, str]:
    times = [] if controller.span is None else [float(t) for t in controller.span]
    names = ("startTime", "stopTime")
    return {name: repr(t) for name, t in zip(names, times, strict=False) if math.isfinite(t)}


def _add_fmu_variables(controller: Controller, variables: ElementTree.Element) -> None:
    """Add inputs, commands and alarms in the order of their value references."""
    kinds = [("input", "continuous", controller.states), ("output", "discrete", controller.commands)]
    reals = [(*kind, *pair) for *kind, of in kinds for pair in zip(of.labels, of.units, strict=True)]
    taken = set()
    for reference, (causality, variability, label, unit) in enumerate(reals):
        variable = _add_fmi_scalar_variable(variables, label, reference, causality, variability)
        _add_xml_element(variable, "Real", start="0.0", **({"unit": unit} if unit else {}))
        taken.add(label)
    for reference, alarm in enumerate(controller.alarms):
        name = alarm if alarm not in taken else f"alarm {alarm}"
        _add_xml_element(
            _add_fmi_scalar_variable(variables, name, reference, "output", "discrete"),
            "Boolean",
            start="false",
        )


def _add_fmi_scalar_variable(
    variables: ElementTree.Element, name: str, reference: int, causality: str, variability: str
) -> ElementTree.Element:
    exact = {"initial": "exact"} if causality == "output" else {}
    return _add_xml_element(
        variables,
        "ScalarVariable",
        name=name,
        valueReference=str(reference),
        causality=causality,
        variability=variability,
        **exact,
    )


def _add_xml_element(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _get_fmu_binary_folder() -> str:
    bits = "64" if sys.maxsize > 2**32 else "32"
    if sys.platform not in _FOLDERS:
        raise GncOptError(
            f"FMI 2.0 has no folder for libraries of {platform.system()}: write sources only, binary=False."
        )
    return _FOLDERS[sys.platform] + bits


def _compile_fmu_library(compiler: str, sources: Path, code: CCode, name: str) -> bytes:
    # no contraction to fused operations: results equal those of the law in Python
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared"]
    files = [str(sources / _INTERFACE.name), str(code.source)]
    library = sources / name
    done = subprocess.run(
        [compiler, *flags, "-o", str(library), *files, "-lm"], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise GncOptError(f"{compiler} could not compile the unit: {done.stderr.strip()[:500]}")
    return library.read_bytes()


def _write_fmu_archive(file: Path, members: Mapping[str, bytes]) -> None:
    with open_for_atomic_write(file) as stream, zipfile.ZipFile(stream, "w") as archive:
        for name in sorted(members):
            archive.writestr(zipfile.ZipInfo(name, _SAME_DATE), members[name], zipfile.ZIP_DEFLATED)
