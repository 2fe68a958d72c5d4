/* A uniform rod that swings about its end, as an FMU: FMI 2 or 3 (-DFMI=2), with a wall that it hits (-DWALL).
 *
 * The angle is measured from hanging: I phi'' = torque - m g l/2 sin(phi) - damping phi', with I = m l^2 / 3.
 * `behaviour` makes it misbehave from `fail_at` on. What is not defined here is stubbed by the test's fixture.
 */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if FMI == 2
#include "fmi2FunctionTypes.h"
typedef fmi2ValueReference Reference;
#define OK fmi2OK
#define DISCARD fmi2Discard
#define ERROR fmi2Error
#define NAME(f) fmi2##f
#else
#include "fmi3FunctionTypes.h"
typedef fmi3ValueReference Reference;
#define OK fmi3OK
#define DISCARD fmi3Discard
#define ERROR fmi3Error
#define NAME(f) fmi3##f
#endif

enum { TIME, ANGLE, RATE, ANGLE_RATE, RATE_RATE, MASS, LENGTH, DAMPING, GRAVITY, TORQUE, ENERGY, INERTIA, FAIL_AT, WALL_AT, REALS };
enum { FINE, FAILS, TERMINATES, IS_NAN, NO_START, SEARCHES, RETURNS, REMEMBERS, ABORTS, LOOPS };
enum { BEHAVIOUR = 100, STARTED = 101 };

typedef struct {
    double v[REALS], last;
    int behaviour, ready;
#if FMI == 2
    const fmi2CallbackFunctions *callbacks;
#else
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
#endif
} Rod;

static void say(Rod *rod, int status, const char *text) {
#if FMI == 2
    rod->callbacks->logger(rod->callbacks->componentEnvironment, "rod", (fmi2Status)status, "logStatusError", "%s (t = %g)", text, rod->v[TIME]);
#else
    if (rod->log) rod->log(rod->environment, (fmi3Status)status, "logStatusError", text);
#endif
}

static double inertia(const double *v) { return v[MASS] * v[LENGTH] * v[LENGTH] / 3; }

static void evaluate(double *v) {
    double moment = v[MASS] * v[GRAVITY] * v[LENGTH] / 2;
    v[INERTIA] = inertia(v);
    v[ANGLE_RATE] = v[RATE];
    v[RATE_RATE] = (v[TORQUE] - moment * sin(v[ANGLE]) - v[DAMPING] * v[RATE]) / inertia(v);
    v[ENERGY] = inertia(v) * v[RATE] * v[RATE] / 2 + moment * (1 - cos(v[ANGLE]));
}

static int is_due(const Rod *rod, int behaviour) { return rod->behaviour == behaviour && rod->v[TIME] >= rod->v[FAIL_AT] - 1e-12; }

static int refresh(Rod *rod) {
    if (is_due(rod, FAILS)) {
        say(rod, ERROR, "the hinge is broken");
        return ERROR;
    }
    if (is_due(rod, ABORTS)) {
        fprintf(stderr, "assertion failed: the rod is stiff\n");
        abort();
    }
    while (is_due(rod, LOOPS)) continue;
    evaluate(rod->v);
    if (rod->behaviour == REMEMBERS) rod->v[RATE_RATE] -= rod->last, rod->last = rod->v[ANGLE];
    if (is_due(rod, IS_NAN)) rod->v[RATE_RATE] = rod->v[ENERGY] = NAN;
    return OK;
}

/* Steps of the classical Runge-Kutta method, a tenth of a millisecond each or less. */
static int advance(Rod *rod, double h) {
    int n = (int)ceil(h / 1e-4 - 1e-9);
    double end = rod->v[TIME] + h, *v = rod->v, d = h / n;
    for (int k = 0; k < n; k++) {
        double phi = v[ANGLE], w = v[RATE], p[4], q[4], c[3] = {0.5, 0.5, 1};
        for (int s = 0; s < 4; s++) {
            if (s) v[ANGLE] = phi + c[s - 1] * d * p[s - 1], v[RATE] = w + c[s - 1] * d * q[s - 1];
            evaluate(v);
            p[s] = v[ANGLE_RATE], q[s] = v[RATE_RATE];
        }
        v[ANGLE] = phi + d / 6 * (p[0] + 2 * p[1] + 2 * p[2] + p[3]);
        v[RATE] = w + d / 6 * (q[0] + 2 * q[1] + 2 * q[2] + q[3]);
        v[TIME] += d;
        if (is_due(rod, FAILS)) break;
    }
    if (refresh(rod) != OK) return ERROR;
    v[TIME] = end;
    return OK;
}

static int read_reals(Rod *rod, const Reference *vr, size_t n, double *values) {
    if (refresh(rod) != OK) return ERROR;
    for (size_t i = 0; i < n; i++) values[i] = rod->v[vr[i]];
    return OK;
}

static int write_reals(Rod *rod, const Reference *vr, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) {
        /* All but the torque, the damping and the states is fixed once it has started. */
        if (rod->ready && vr[i] != TORQUE && vr[i] != DAMPING && vr[i] > RATE) {
            say(rod, ERROR, "a fixed parameter was set too late");
            return ERROR;
        }
        if (vr[i] == LENGTH && values[i] <= 0) {
            say(rod, ERROR, "a length must be positive");
            return ERROR;
        }
        rod->v[vr[i]] = values[i];
    }
    return OK;
}

static int start(Rod *rod) {
    if (rod->behaviour == NO_START) {
        say(rod, ERROR, "no position at rest");
        return ERROR;
    }
    rod->ready = 1;
    return refresh(rod);
}

static int bounce(Rod *rod) {
#ifdef WALL
    if (rod->v[ANGLE] < rod->v[WALL_AT] && rod->v[RATE] < 0) {
        rod->v[RATE] *= -0.8;
        return 1;
    }
#else
    (void)rod;
#endif
    return 0;
}

static Rod *made(void) {
    const double first[REALS] = {0, 1, 0, 0, 0, 1, 1, 0.1, 9.81, 0, 0, 0, 1e9, -0.5};
    Rod *rod = calloc(1, sizeof(Rod));
    memcpy(rod->v, first, sizeof first);
    return rod;
}

/* What is spelt alike in both versions. */
int NAME(ExitInitializationMode)(Rod *rod) { return start(rod); }
int NAME(EnterEventMode)(Rod *rod) { return (void)rod, OK; }
int NAME(EnterContinuousTimeMode)(Rod *rod) { return (void)rod, OK; }
int NAME(Terminate)(Rod *rod) { return (void)rod, OK; }
void NAME(FreeInstance)(Rod *rod) { free(rod); }
int NAME(SetTime)(Rod *rod, double t) { return rod->v[TIME] = t, OK; }
int NAME(SetContinuousStates)(Rod *rod, const double *x, size_t n) { return memcpy(rod->v + ANGLE, x, n * sizeof *x), OK; }
int NAME(GetContinuousStates)(Rod *rod, double *x, size_t n) { return memcpy(x, rod->v + ANGLE, n * sizeof *x), OK; }
int NAME(GetNominalsOfContinuousStates)(Rod *rod, double *x, size_t n) {
    for (size_t i = 0; i < n; i++) x[i] = 1;
    return (void)rod, OK;
}
int NAME(GetEventIndicators)(Rod *rod, double *z, size_t n) {
    if (n) z[0] = rod->v[ANGLE] - rod->v[WALL_AT];
    return OK;
}

#if FMI == 2
void *fmi2Instantiate(const char *name, fmi2Type type, const char *guid, const char *resources, const fmi2CallbackFunctions *callbacks, int visible, int logging) {
    (void)name, (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
    Rod *rod = made();
    rod->callbacks = callbacks;
    return rod;
}
int fmi2SetupExperiment(Rod *rod, int has, double tolerance, double t, int ends, double end) { return (void)has, (void)tolerance, (void)ends, (void)end, rod->v[TIME] = t, OK; }
int fmi2EnterInitializationMode(Rod *rod) { return (void)rod, OK; }
int fmi2GetReal(Rod *rod, const Reference *vr, size_t n, double *values) { return read_reals(rod, vr, n, values); }
int fmi2SetReal(Rod *rod, const Reference *vr, size_t n, const double *values) { return write_reals(rod, vr, n, values); }
int fmi2SetInteger(Rod *rod, const Reference *vr, size_t n, const int *values) { return (void)vr, n ? rod->behaviour = values[0] : 0, OK; }
int fmi2SetBoolean(Rod *rod, const Reference *vr, size_t n, const int *values) { return (void)rod, (void)vr, (void)n, (void)values, OK; }
int fmi2GetDerivatives(Rod *rod, double *x, size_t n) {
    if (refresh(rod) != OK) return ERROR;
    return memcpy(x, rod->v + ANGLE_RATE, n * sizeof *x), OK;
}
int fmi2NewDiscreteStates(Rod *rod, fmi2EventInfo *info) {
    memset(info, 0, sizeof *info);
    info->valuesOfContinuousStatesChanged = bounce(rod);
    info->terminateSimulation = is_due(rod, TERMINATES);
    info->newDiscreteStatesNeeded = is_due(rod, SEARCHES);
    info->nextEventTimeDefined = is_due(rod, RETURNS), info->nextEventTime = rod->v[TIME];
    return OK;
}
int fmi2CompletedIntegratorStep(Rod *rod, int keep, int *event, int *ends) { return (void)keep, *event = 0, *ends = is_due(rod, TERMINATES), OK; }
int fmi2DoStep(Rod *rod, double t, double h, int keep) {
    (void)t, (void)keep;
    int status = advance(rod, h);
    return status == OK && is_due(rod, TERMINATES) ? DISCARD : status;
}
int fmi2GetBooleanStatus(Rod *rod, int kind, int *value) { return (void)kind, *value = is_due(rod, TERMINATES), OK; }
#else
static Rod *begun(fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    Rod *rod = made();
    rod->environment = environment, rod->log = log;
    return rod;
}
void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, _Bool visible, _Bool logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    return begun(environment, log);
}
void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, _Bool visible, _Bool logging, _Bool events, _Bool early, const Reference *needed, size_t n, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, void *update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)needed, (void)n, (void)update;
    return begun(environment, log);
}
int fmi3EnterInitializationMode(Rod *rod, _Bool has, double tolerance, double t, _Bool ends, double end) { return (void)has, (void)tolerance, (void)ends, (void)end, rod->v[TIME] = t, OK; }
int fmi3GetFloat64(Rod *rod, const Reference *vr, size_t n, double *values, size_t m) { return (void)m, read_reals(rod, vr, n, values); }
int fmi3SetFloat64(Rod *rod, const Reference *vr, size_t n, const double *values, size_t m) { return (void)m, write_reals(rod, vr, n, values); }
int fmi3SetInt32(Rod *rod, const Reference *vr, size_t n, const int *values, size_t m) { return (void)vr, (void)m, n ? rod->behaviour = values[0] : 0, OK; }
int fmi3SetBoolean(Rod *rod, const Reference *vr, size_t n, const _Bool *values, size_t m) { return (void)rod, (void)vr, (void)n, (void)values, (void)m, OK; }
int fmi3GetContinuousStateDerivatives(Rod *rod, double *x, size_t n) {
    if (refresh(rod) != OK) return ERROR;
    return memcpy(x, rod->v + ANGLE_RATE, n * sizeof *x), OK;
}
int fmi3UpdateDiscreteStates(Rod *rod, _Bool *again, _Bool *ends, _Bool *nominals, _Bool *states, _Bool *timed, double *next) {
    *again = is_due(rod, SEARCHES), *nominals = 0, *states = bounce(rod), *ends = is_due(rod, TERMINATES);
    *timed = is_due(rod, RETURNS), *next = rod->v[TIME];
    return OK;
}
int fmi3CompletedIntegratorStep(Rod *rod, _Bool keep, _Bool *event, _Bool *ends) { return (void)keep, *event = 0, *ends = is_due(rod, TERMINATES), OK; }
int fmi3DoStep(Rod *rod, double t, double h, _Bool keep, _Bool *event, _Bool *ends, _Bool *early, double *last) {
    (void)t, (void)keep;
    int status = advance(rod, h);
    *event = *early = 0, *ends = is_due(rod, TERMINATES), *last = rod->v[TIME];
    return status;
}
#endif
