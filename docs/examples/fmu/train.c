/* A train as a point mass, as a co-simulation FMU of FMI 3.0 without any tool or header. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { OK = 0, ERROR = 3 };
enum { TIME, F_DRIVE, F_BRAKE, SLOPE, MASS, INERTIA, C0, C1, C2, START, PLACE, SPEED, ACCEL, COUNT };

typedef struct {
    double value[COUNT]; /* By value reference. */
} Train;

static void step(Train *train, double step_s) {
    double *v = train->value, speed = v[SPEED], gain = step_s / v[INERTIA];
    double slope_n = v[MASS] * 9.81 * v[SLOPE] / 1000.0;
    double drag_n = (v[C1] + v[C2] * fabs(speed)) * speed;
    double next = speed + gain * (v[F_DRIVE] - slope_n - drag_n);
    double held = gain * (v[F_BRAKE] + v[C0]); /* Friction never turns the train round. */
    next = next > 0.0 ? fmax(0.0, next - held) : fmin(0.0, next + held);
    v[PLACE] += 0.5 * (speed + next) * step_s;
    v[ACCEL] = (next - speed) / step_s;
    v[SPEED] = next;
    v[TIME] += step_s;
}

const char *fmi3GetVersion(void) { return "3.0"; }

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                  _Bool visible, _Bool logging, _Bool events, _Bool early,
                                  const uint32_t *required, size_t count, void *environment,
                                  void *log, void *update) {
    return strcmp(token, "metro-train-1") == 0 ? calloc(1, sizeof(Train)) : NULL;
}

void *fmi3InstantiateModelExchange(void) { return NULL; }
void *fmi3InstantiateScheduledExecution(void) { return NULL; }
void fmi3FreeInstance(void *train) { free(train); }
int fmi3SetDebugLogging(void *train, _Bool on, size_t count, const char **names) { return OK; }
int fmi3Terminate(void *train) { return OK; }
int fmi3ExitInitializationMode(void *train) { return OK; }

int fmi3Reset(void *train) {
    memset(train, 0, sizeof(Train));
    return OK;
}

int fmi3EnterInitializationMode(void *train, _Bool tolerant, double tolerance, double start_s,
                                _Bool ends, double end_s) {
    Train *t = train;
    t->value[TIME] = start_s;
    t->value[PLACE] = t->value[START];
    return t->value[MASS] > 0.0 && t->value[INERTIA] > 0.0 ? OK : ERROR;
}

int fmi3SetFloat64(void *train, const uint32_t *references, size_t count, const double *values,
                   size_t total) {
    for (size_t i = 0; i < count; i++) {
        if (references[i] < F_DRIVE || references[i] > START) return ERROR;
        ((Train *)train)->value[references[i]] = values[i];
    }
    return OK;
}

int fmi3GetFloat64(void *train, const uint32_t *references, size_t count, double *values,
                   size_t total) {
    for (size_t i = 0; i < count; i++) {
        if (references[i] >= COUNT) return ERROR;
        values[i] = ((Train *)train)->value[references[i]];
    }
    return OK;
}

int fmi3DoStep(void *train, double from_s, double step_s, _Bool no_set, _Bool *event, _Bool *ends,
               _Bool *early, double *last_s) {
    step(train, step_s);
    *event = *ends = *early = 0;
    *last_s = from_s + step_s;
    return OK;
}

/* The standard asks for all functions; a co-simulation of floats has no use for these. */
#define NOT_THERE(name) int fmi3##name(void) { return ERROR; }
NOT_THERE(ActivateModelPartition) NOT_THERE(CompletedIntegratorStep)
NOT_THERE(DeserializeFMUState) NOT_THERE(EnterConfigurationMode)
NOT_THERE(EnterContinuousTimeMode) NOT_THERE(EnterEventMode) NOT_THERE(EnterStepMode)
NOT_THERE(EvaluateDiscreteStates) NOT_THERE(ExitConfigurationMode) NOT_THERE(FreeFMUState)
NOT_THERE(GetAdjointDerivative) NOT_THERE(GetBinary) NOT_THERE(GetBoolean) NOT_THERE(GetClock)
NOT_THERE(GetContinuousStateDerivatives) NOT_THERE(GetContinuousStates)
NOT_THERE(GetDirectionalDerivative) NOT_THERE(GetEventIndicators) NOT_THERE(GetFMUState)
NOT_THERE(GetFloat32) NOT_THERE(GetInt16) NOT_THERE(GetInt32) NOT_THERE(GetInt64)
NOT_THERE(GetInt8) NOT_THERE(GetIntervalDecimal) NOT_THERE(GetIntervalFraction)
NOT_THERE(GetNominalsOfContinuousStates) NOT_THERE(GetNumberOfContinuousStates)
NOT_THERE(GetNumberOfEventIndicators) NOT_THERE(GetNumberOfVariableDependencies)
NOT_THERE(GetOutputDerivatives) NOT_THERE(GetShiftDecimal) NOT_THERE(GetShiftFraction)
NOT_THERE(GetString) NOT_THERE(GetUInt16) NOT_THERE(GetUInt32) NOT_THERE(GetUInt64)
NOT_THERE(GetUInt8) NOT_THERE(GetVariableDependencies) NOT_THERE(SerializeFMUState)
NOT_THERE(SerializedFMUStateSize) NOT_THERE(SetBinary) NOT_THERE(SetBoolean) NOT_THERE(SetClock)
NOT_THERE(SetContinuousStates) NOT_THERE(SetFMUState) NOT_THERE(SetFloat32) NOT_THERE(SetInt16)
NOT_THERE(SetInt32) NOT_THERE(SetInt64) NOT_THERE(SetInt8) NOT_THERE(SetIntervalDecimal)
NOT_THERE(SetIntervalFraction) NOT_THERE(SetShiftDecimal) NOT_THERE(SetShiftFraction)
NOT_THERE(SetString) NOT_THERE(SetTime) NOT_THERE(SetUInt16) NOT_THERE(SetUInt32)
NOT_THERE(SetUInt64) NOT_THERE(SetUInt8) NOT_THERE(UpdateDiscreteStates)
