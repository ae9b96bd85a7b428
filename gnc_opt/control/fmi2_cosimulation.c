/* A sampled control law behind the interface of FMI 2.0 for co-simulation (Modelica Association, FMI 2.0.4).
 *
 * The law runs at the times start + k DT. A call of fmi2DoStep(t, h) runs the samples in [t, t + h) with the inputs
 * that were set before it; the outputs are the command that is held from the last sample on. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_law.h" /* what the law is called, its sizes, alarms and guid */

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif

typedef int Status;
enum { OK = 0, DISCARD = 2, ERROR = 3 };

typedef struct {
    double x[LAW_N_STATES], u[LAW_N_COMMANDS], z[LAW_N_MEMORY];
    double start; /* time of the first sample, s */
    double count; /* samples so far */
} Law;

static void begin(Law *law, double start)
{
    memset(law, 0, sizeof *law);
    law->start = start;
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                             const void *callbacks, int visible, int logging)
{
    Law *law;
    (void)name, (void)resources, (void)callbacks, (void)visible, (void)logging;
    if (type != 1 /* co-simulation */ || !guid || strcmp(guid, LAW_GUID) != 0)
        return NULL;
    law = malloc(sizeof *law);
    if (law)
        begin(law, 0.0);
    return law;
}

EXPORT void fmi2FreeInstance(void *c) { free(c); }

EXPORT Status fmi2SetupExperiment(void *c, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    if (!isfinite(start))
        return ERROR;
    ((Law *)c)->start = start;
    return OK;
}

EXPORT Status fmi2Reset(void *c)
{
    begin(c, 0.0);
    return OK;
}

EXPORT Status fmi2DoStep(void *c, double t, double h, int no_return)
{
    Law *law = c;
    const double margin = 1e-6 * LAW_DT; /* times of co-simulation are sums of steps, and rounded */
    double sample = law->start + law->count * LAW_DT;
    (void)no_return;
    if (!(h > 0.0) || !isfinite(h) || !(t <= sample + margin))
        return ERROR;
    while (sample < t + h - margin) {
        if (!(law->count > 0.0))
            LAW_START(sample, law->x, law->z);
        LAW_STEP(sample, law->x, law->z, law->u);
        law->count += 1.0;
        sample = law->start + law->count * LAW_DT;
    }
    return OK;
}

EXPORT Status fmi2SetReal(void *c, const unsigned int *vr, size_t n, const double *value)
{
    size_t i;
    for (i = 0; i < n; ++i) {
        if (vr[i] >= LAW_N_STATES)
            return ERROR;
        ((Law *)c)->x[vr[i]] = value[i];
    }
    return OK;
}

EXPORT Status fmi2GetReal(void *c, const unsigned int *vr, size_t n, double *value)
{
    const Law *law = c;
    size_t i;
    for (i = 0; i < n; ++i) {
        if (vr[i] >= LAW_N_STATES + LAW_N_COMMANDS)
            return ERROR;
        value[i] = vr[i] < LAW_N_STATES ? law->x[vr[i]] : law->u[vr[i] - LAW_N_STATES];
    }
    return OK;
}

EXPORT Status fmi2GetBoolean(void *c, const unsigned int *vr, size_t n, int *value)
{
    static const int alarms[] = LAW_ALARMS;
    size_t i;
    for (i = 0; i < n; ++i) {
        if (vr[i] >= LAW_N_ALARMS)
            return ERROR;
        value[i] = !(fabs(((const Law *)c)->z[alarms[vr[i]]]) <= 0.0);
    }
    return OK;
}

EXPORT Status fmi2GetFMUstate(void *c, void **state)
{
    if (!*state)
        *state = malloc(sizeof(Law));
    if (!*state)
        return ERROR;
    memcpy(*state, c, sizeof(Law));
    return OK;
}

EXPORT Status fmi2SetFMUstate(void *c, void *state)
{
    memcpy(c, state, sizeof(Law));
    return OK;
}

EXPORT Status fmi2FreeFMUstate(void *c, void **state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}

EXPORT Status fmi2SerializedFMUstateSize(void *c, void *state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(Law);
    return OK;
}

EXPORT Status fmi2SerializeFMUstate(void *c, void *state, char bytes[], size_t size)
{
    (void)c;
    if (size < sizeof(Law))
        return ERROR;
    memcpy(bytes, state, sizeof(Law));
    return OK;
}

EXPORT Status fmi2DeSerializeFMUstate(void *c, const char bytes[], size_t size, void **state)
{
    if (size != sizeof(Law) || fmi2GetFMUstate(c, state) != OK)
        return ERROR;
    memcpy(*state, bytes, sizeof(Law));
    return OK;
}

/* What a law at its own pace has nothing to do for, and what it does not have. */
EXPORT Status fmi2SetDebugLogging(void *c, int on, size_t n, const char *const categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return OK;
}
EXPORT Status fmi2EnterInitializationMode(void *c) { (void)c; return OK; }
EXPORT Status fmi2ExitInitializationMode(void *c) { (void)c; return OK; }
EXPORT Status fmi2Terminate(void *c) { (void)c; return OK; }
EXPORT Status fmi2CancelStep(void *c) { (void)c; return ERROR; }

#define NOTHING(name, type)                                                        \
    EXPORT Status name(void *c, const unsigned int *vr, size_t n, type value)      \
    {                                                                              \
        (void)c, (void)vr, (void)value;                                            \
        return n ? ERROR : OK;                                                     \
    }
NOTHING(fmi2GetInteger, int *)
NOTHING(fmi2GetString, const char **)
NOTHING(fmi2SetInteger, const int *)
NOTHING(fmi2SetBoolean, const int *)
NOTHING(fmi2SetString, const char *const *)

#define NO_DERIVATIVES(name, type)                                                                   \
    EXPORT Status name(void *c, const unsigned int *vr, size_t n, const int *order, type value)      \
    {                                                                                                \
        (void)c, (void)vr, (void)order, (void)value;                                                 \
        return n ? ERROR : OK;                                                                       \
    }
NO_DERIVATIVES(fmi2SetRealInputDerivatives, const double *)
NO_DERIVATIVES(fmi2GetRealOutputDerivatives, double *)

EXPORT Status fmi2GetDirectionalDerivative(void *c, const unsigned int *unknown, size_t n_unknown,
                                           const unsigned int *known, size_t n_known, const double *seed, double *value)
{
    (void)c, (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)seed, (void)value;
    return ERROR;
}

/* No step is ever pending. */
#define NOT_PENDING(name, type)                        \
    EXPORT Status name(void *c, int kind, type *value) \
    {                                                  \
        (void)c, (void)kind, (void)value;              \
        return DISCARD;                                \
    }
NOT_PENDING(fmi2GetStatus, Status)
NOT_PENDING(fmi2GetRealStatus, double)
NOT_PENDING(fmi2GetIntegerStatus, int)
NOT_PENDING(fmi2GetBooleanStatus, int)
NOT_PENDING(fmi2GetStringStatus, const char *)
