"""Mock-up units and single precision under address and undefined-behaviour sanitizers, with samples of all kinds."""

import zipfile
from types import SimpleNamespace

import numpy as np
import pytest
from testing.c_compiler import follower, holder, needs_compiler, python, run, sanitized
from testing.mpc_designs import tracker

import gnc_opt as go

pytestmark = needs_compiler

START, DT = 0.5, 0.1
MASTER = """
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include "fmu_law.h"
void *fmi2Instantiate(const char *, int, const char *, const char *, const void *, int, int);
void fmi2FreeInstance(void *);
int fmi2SetupExperiment(void *, int, double, double, int, double);
int fmi2Reset(void *);
int fmi2DoStep(void *, double, double, int);
int fmi2SetReal(void *, const unsigned int *, size_t, const double *);
int fmi2GetReal(void *, const unsigned int *, size_t, double *);
int fmi2GetBoolean(void *, const unsigned int *, size_t, int *);
int fmi2GetFMUstate(void *, void **);
int fmi2SetFMUstate(void *, void *);
int fmi2FreeFMUstate(void *, void **);
int fmi2SerializeFMUstate(void *, void *, char *, size_t);
int fmi2SerializedFMUstateSize(void *, void *, size_t *);
int fmi2DeSerializeFMUstate(void *, const char *, size_t, void **);
int main(void)
{
    void *unit = fmi2Instantiate("unit", 1, LAW_GUID, "", NULL, 0, 0), *kept = NULL;
    unsigned int i, real[LAW_N_STATES + LAW_N_COMMANDS + 1], alarm[LAW_N_ALARMS + 1];
    double t, now = 0.5, x[LAW_N_STATES], u[LAW_N_COMMANDS];
    int told[LAW_N_ALARMS + 1];
    size_t size;
    char *bytes;
    for (i = 0; i <= LAW_N_STATES + LAW_N_COMMANDS; ++i)
        real[i] = i;
    for (i = 0; i <= LAW_N_ALARMS; ++i)
        alarm[i] = i;
    if (!unit || fmi2Instantiate("unit", 1, "other", "", NULL, 0, 0))
        return 1;
    if (fmi2Instantiate("unit", 0, LAW_GUID, "", NULL, 0, 0) || !fmi2SetupExperiment(unit, 0, 0.0, (double)NAN, 0, 0.0))
        return 1;
    if (fmi2Reset(unit) || fmi2SetupExperiment(unit, 0, 0.0, now, 0, 0.0))
        return 2;
    while (scanf("%lf", &t) == 1) { /* times are those of the samples */
        for (i = 0; i < LAW_N_STATES; ++i)
            if (scanf("%lf", &x[i]) != 1)
                return 3;
        if (fmi2SetReal(unit, real, LAW_N_STATES, x) || fmi2DoStep(unit, now, LAW_DT, 1))
            return 4;
        now += LAW_DT;
        /* the state is kept, sent through bytes, and taken up again */
        if (fmi2GetFMUstate(unit, &kept) || fmi2SerializedFMUstateSize(unit, kept, &size))
            return 5;
        bytes = malloc(size);
        if (!bytes || fmi2SerializeFMUstate(unit, kept, bytes, size))
            return 6;
        if (!fmi2SerializeFMUstate(unit, kept, bytes, size - 1))
            return 6;
        if (fmi2Reset(unit) || fmi2FreeFMUstate(unit, &kept) || fmi2DeSerializeFMUstate(unit, bytes, size, &kept))
            return 7;
        if (fmi2SetFMUstate(unit, kept) || !fmi2DeSerializeFMUstate(unit, bytes, size - 1, &kept))
            return 8;
        free(bytes);
        if (fmi2GetReal(unit, real + LAW_N_STATES, LAW_N_COMMANDS, u))
            return 9;
        if (fmi2GetBoolean(unit, alarm, LAW_N_ALARMS, told))
            return 9;
        for (i = 0; i < LAW_N_COMMANDS; ++i)
            printf("%.17g ", u[i]);
        for (i = 0; i < LAW_N_ALARMS; ++i)
            printf("%d ", told[i]);
        printf("\\n");
    }
    /* what is not there, and steps that are none */
    if (!fmi2SetReal(unit, real + LAW_N_STATES, 1, x) || !fmi2GetBoolean(unit, alarm + LAW_N_ALARMS, 1, told))
        return 10;
    if (!fmi2GetReal(unit, real + LAW_N_STATES + LAW_N_COMMANDS, 1, u) || !fmi2DoStep(unit, now + 1.0, LAW_DT, 1))
        return 10;
    if (!fmi2DoStep(unit, now, -1.0, 1) || !fmi2DoStep(unit, now, (double)NAN, 1))
        return 11;
    if (!fmi2DoStep(unit, now, (double)INFINITY, 1))
        return 12;
    fmi2FreeFMUstate(unit, &kept);
    fmi2FreeInstance(unit);
    return 0;
}
"""
STATES = np.array(
    [[np.nan, 0], [0, 0], [1e300, -1e300], [0.1, np.inf], [1e31, 0], [0, -np.inf], [0.3, -0.1], [-0.2, 0.1]]
)


def limited():
    return tracker(rate_limits=5.0, state_limits={"v": (-0.5, 0.5)}, hard=["v"])


@pytest.mark.parametrize("design", [lambda: follower(DT), lambda: holder(DT), limited])
def test_a_unit_keeps_to_its_memory_and_gives_the_law(tmp_path, design):
    controller = design()
    unit = go.export_fmu(controller, tmp_path / "law.fmu", binary=False)
    with zipfile.ZipFile(unit.file) as archive:
        archive.extractall(tmp_path)
    sources = tmp_path / "sources"
    (sources / "master.c").write_text(MASTER)
    code = SimpleNamespace(header=sources / "law.h", source=sources / "law.c", driver=sources / "master.c")
    program = sanitized(code, str(sources / "fmi2_cosimulation.c"), "-O1")
    times = START + DT * np.arange(len(STATES))
    found = run(program, times, STATES)
    expected, told, z = [], [], None
    for t, x in zip(times, STATES, strict=True):
        u, z = controller(t, x, z)
        expected.append(u)
        told.append([z[controller.memory.slice(a)][0] != 0 for a in controller.alarms])
    commands = controller.commands.size
    assert found[:, :commands] == pytest.approx(np.array(expected), rel=1e-9, abs=1e-8)
    assert np.array_equal(found[:, commands:], told)


def test_single_precision_keeps_to_its_memory(tmp_path):
    controller = holder(DT)
    options = {"precision": "float32"}
    program = sanitized(go.export_c(controller, tmp_path, **options), "-O1")
    times = START + DT * np.arange(len(STATES))
    found = run(program, times, STATES)
    assert found == pytest.approx(python(controller, times, STATES, DT), rel=2e-2, abs=1e-4)
