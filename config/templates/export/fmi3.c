/* FMI 3.0 for co-simulation of $name, around the functions of ${name}.h. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "${name}.h"

#define EXPORT __attribute__((visibility("default")))

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef enum { INSTANTIATED, INITIALIZATION, STEP, TERMINATED } Mode;
typedef void (*Log)(void *environment, int status, const char *category, const char *message);

/* Value references: outputs, then numbers of a command, then the initial q and p, then numbers of
   the scene, those that can be changed first. */
enum {
  FIRST_INPUT = ${NAME}_OUTPUTS, FIRST_START = FIRST_INPUT + ${NAME}_INPUTS, STARTS = $starts,
  FIRST_NUMBER = FIRST_START + STARTS, FIRST_CONSTANT = FIRST_NUMBER + ${NAME}_PARAMETERS,
  REFERENCES = FIRST_NUMBER + $numbers
};
static const double START[] = {$start_values 0.0}, NUMBERS[] = {$number_values 0.0};

/* All that changes, besides the state. */
typedef struct {
  int64_t mode;
  double begin, inputs[${NAME}_INPUTS + 1], start[STARTS + 1], numbers[${NAME}_PARAMETERS + 1];
} Values;

/* A stored state: its size, a checksum of the rest, and the rest. */
typedef struct {
  uint64_t size, sum;
  Values values;
  int64_t saved[${NAME}_SAVED_WORDS];
} Stored;

typedef struct {
  ${name}_state *state;
  Values values;
  void *environment;
  Log log;
  bool early;
} Instance;

static Status refuse(const Instance *own, const char *message)
{
  if (own != NULL && own->log != NULL) {
    own->log(own->environment, ERROR, "logStatusError", message);
  }
  return ERROR;
}

static Status reset(Instance *own)
{
  memset(&own->values, 0, sizeof own->values);
  own->values.mode = INSTANTIATED;
  for (int k = 0; k < ${NAME}_INPUTS; ++k) {
    own->values.inputs[k] = NAN;
  }
  memcpy(own->values.start, START, STARTS * sizeof(double));
  memcpy(own->values.numbers, NUMBERS, ${NAME}_PARAMETERS * sizeof(double));
  return ${name}_init(own->state) == ${NAME}_OK ? OK : ERROR;
}

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT Status fmi3SetDebugLogging(Instance *own, bool on, size_t n, const char *const *categories)
{
  (void)on, (void)n, (void)categories;
  return own == NULL ? ERROR : OK;
}

EXPORT void fmi3FreeInstance(Instance *own)
{
  if (own != NULL) {
    free(own->state);
    free(own);
  }
}

EXPORT Instance *fmi3InstantiateCoSimulation(
  const char *name, const char *token, const char *resources, bool visible, bool logging,
  bool events, bool early, const uint32_t *required, size_t n, void *environment, Log log,
  void *intermediate)
{
  (void)resources, (void)visible, (void)required, (void)n, (void)intermediate;
  if (name == NULL || token == NULL || strcmp(token, "$token") != 0 || events) {
    return NULL;
  }
  Instance *own = calloc(1, sizeof *own);
  if (own == NULL) {
    return NULL;
  }
  own->state = aligned_alloc(64, sizeof *own->state);
  own->environment = environment;
  own->log = logging ? log : NULL;
  own->early = early;
  if (own->state == NULL || reset(own) != OK) {
    fmi3FreeInstance(own);
    return NULL;
  }
  return own;
}

EXPORT Status fmi3EnterInitializationMode(
  Instance *own, bool has_tolerance, double tolerance, double begin, bool has_stop, double stop)
{
  (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
  if (own == NULL || own->values.mode != INSTANTIATED || !isfinite(begin)) {
    return refuse(own, "fmi3EnterInitializationMode needs a new instance and a finite start time");
  }
  own->values.begin = begin;
  own->values.mode = INITIALIZATION;
  return OK;
}

EXPORT Status fmi3ExitInitializationMode(Instance *own)
{
  if (own == NULL || own->values.mode != INITIALIZATION) {
    return refuse(own, "fmi3ExitInitializationMode needs the initialization mode");
  }
  own->values.mode = STEP;
  return OK;
}

EXPORT Status fmi3Terminate(Instance *own)
{
  if (own == NULL || own->values.mode != STEP) {
    return refuse(own, "fmi3Terminate needs the step mode");
  }
  own->values.mode = TERMINATED;
  return OK;
}

EXPORT Status fmi3Reset(Instance *own) { return own == NULL ? ERROR : reset(own); }

static bool known(const uint32_t *references, size_t n, const double *values, size_t count)
{
  if (n != count || (n > 0 && (references == NULL || values == NULL))) {
    return false;
  }
  for (size_t k = 0; k < n; ++k) {
    if (references[k] >= REFERENCES) {
      return false;
    }
  }
  return true;
}

EXPORT Status fmi3GetFloat64(
  Instance *own, const uint32_t *references, size_t n, double *values, size_t count)
{
  double outputs[${NAME}_OUTPUTS];
  if (own == NULL || !known(references, n, values, count)) {
    return refuse(own, "fmi3GetFloat64: unknown value reference, or another number of values");
  }
  if (${name}_outputs(own->state, outputs) != ${NAME}_OK) {
    return refuse(own, "fmi3GetFloat64: the outputs have no value");
  }
  outputs[${NAME}_OUT_TIME] += own->values.begin;
  for (size_t k = 0; k < n; ++k) {
    const uint32_t i = references[k];
    values[k] = i < FIRST_INPUT ? outputs[i] :
      i < FIRST_START ? own->values.inputs[i - FIRST_INPUT] :
      i < FIRST_NUMBER ? own->values.start[i - FIRST_START] :
      i < FIRST_CONSTANT ? own->values.numbers[i - FIRST_NUMBER] : NUMBERS[i - FIRST_NUMBER];
  }
  return OK;
}

EXPORT Status fmi3SetFloat64(
  Instance *own, const uint32_t *references, size_t n, const double *values, size_t count)
{
  if (own == NULL || own->values.mode == TERMINATED || !known(references, n, values, count)) {
    return refuse(own, "fmi3SetFloat64: unknown value reference, another number of values, or "
                       "a terminated instance");
  }
  Values wanted = own->values;
  bool moved = false, tuned = false;
  for (size_t k = 0; k < n; ++k) {
    const uint32_t i = references[k];
    const bool starts = FIRST_START <= i && i < FIRST_NUMBER;
    if (i < FIRST_INPUT || i >= FIRST_CONSTANT || isinf(values[k]) ||
      (starts && wanted.mode == STEP) || (i >= FIRST_START && isnan(values[k])))
    {
      return refuse(own, "fmi3SetFloat64: outputs and constants cannot be set, initial values "
                         "only before the first step, and values are finite");
    }
    *(starts ? &wanted.start[i - FIRST_START] : i < FIRST_START ?
      &wanted.inputs[i - FIRST_INPUT] : &wanted.numbers[i - FIRST_NUMBER]) = values[k];
    moved = moved || starts;
    tuned = tuned || i >= FIRST_NUMBER;
  }
  if ((tuned && ${name}_tune(own->state, wanted.numbers) != ${NAME}_OK) ||
    (moved && ${name}_start(own->state, wanted.start, wanted.start + ${NAME}_Q_SIZE) !=
    ${NAME}_OK))
  {
    ${name}_tune(own->state, own->values.numbers);
    if (moved) {
      ${name}_start(own->state, own->values.start, own->values.start + ${NAME}_Q_SIZE);
    }
    return refuse(own, "fmi3SetFloat64: a parameter is out of its range, or H has no finite "
                       "gradient at the state");
  }
  own->values = wanted;
  return OK;
}

EXPORT Status fmi3DoStep(
  Instance *own, double now, double size, bool no_set_before, bool *event, bool *terminate,
  bool *early, double *last)
{
  (void)no_set_before;
  if (own == NULL || own->values.mode != STEP || event == NULL || terminate == NULL ||
    early == NULL || last == NULL)
  {
    return refuse(own, "fmi3DoStep needs the step mode");
  }
  double outputs[${NAME}_OUTPUTS];
  if (${name}_outputs(own->state, outputs) != ${NAME}_OK) {
    return refuse(own, "fmi3DoStep: the outputs have no value");
  }
  const double time = own->values.begin + outputs[${NAME}_OUT_TIME];
  const double steps = nearbyint(size / ${NAME}_STEP_SIZE);
  *event = *terminate = *early = false;
  *last = time;
  /* Times differ by the rounding of sums; steps are whole. */
  if (!(fabs(now - time) <= 1e-6 * ${NAME}_STEP_SIZE + 1e-12 * fabs(time))) {
    return refuse(own, "fmi3DoStep: currentCommunicationPoint is not the time of the instance");
  }
  if (!(steps >= 1.0 && steps < 9e15 &&
    fabs(size - steps * ${NAME}_STEP_SIZE) <= 1e-6 * ${NAME}_STEP_SIZE))
  {
    return refuse(own, "fmi3DoStep: communicationStepSize is no multiple of $step_size s");
  }
  const double end = outputs[${NAME}_OUT_TIME] / ${NAME}_STEP_SIZE + steps;
  double left = steps;
  int32_t status;
  do {
    status = ${name}_step(own->state, left == steps ? own->values.inputs : NULL, (int64_t)left);
    ${name}_outputs(own->state, outputs);
    left = nearbyint(end - outputs[${NAME}_OUT_TIME] / ${NAME}_STEP_SIZE);
  } while (status == ${NAME}_EVENT && left > 0.0 && !own->early);
  *last = own->values.begin + outputs[${NAME}_OUT_TIME];
  if (status == ${NAME}_EVENT) {
    *early = left > 0.0;
    return OK;
  }
  if (status == ${NAME}_INVALID_COMMAND) {
    return refuse(own, "fmi3DoStep: an input is out of its range");
  }
  if (status != ${NAME}_OK) {
    *terminate = true;
    return refuse(own, "fmi3DoStep: a step failed, see the output residual");
  }
  return OK;
}

static uint64_t sum_of(const Stored *stored)
{
  /* FNV-1a, 64 bits. */
  const unsigned char *bytes = (const unsigned char *)&stored->values;
  uint64_t sum = 14695981039346656037u;
  for (size_t k = 0; k < sizeof *stored - offsetof(Stored, values); ++k) {
    sum = (sum ^ bytes[k]) * 1099511628211u;
  }
  return sum;
}

EXPORT Status fmi3GetFMUState(Instance *own, Stored **stored)
{
  if (own == NULL || stored == NULL) {
    return ERROR;
  }
  Stored *found = *stored == NULL ? calloc(1, sizeof *found) : *stored;
  if (found == NULL || ${name}_save(own->state, found->saved) != ${NAME}_OK) {
    return ERROR;
  }
  found->size = sizeof *found;
  found->values = own->values;
  found->sum = sum_of(found);
  *stored = found;
  return OK;
}

EXPORT Status fmi3SetFMUState(Instance *own, Stored *stored)
{
  if (own == NULL || stored == NULL || stored->size != sizeof *stored ||
    stored->sum != sum_of(stored) || ${name}_restore(own->state, stored->saved) != ${NAME}_OK)
  {
    return refuse(own, "fmi3SetFMUState: the state is of another FMU, or damaged");
  }
  /* Numbers change what is computed from them, which is restored after that. */
  ${name}_tune(own->state, stored->values.numbers);
  ${name}_restore(own->state, stored->saved);
  own->values = stored->values;
  return OK;
}

EXPORT Status fmi3FreeFMUState(Instance *own, Stored **stored)
{
  if (own == NULL || stored == NULL) {
    return ERROR;
  }
  free(*stored);
  *stored = NULL;
  return OK;
}

EXPORT Status fmi3SerializedFMUStateSize(Instance *own, const Stored *stored, size_t *size)
{
  if (own == NULL || stored == NULL || size == NULL) {
    return refuse(own, "fmi3SerializedFMUStateSize needs a state");
  }
  *size = sizeof *stored;
  return OK;
}

EXPORT Status fmi3SerializeFMUState(
  Instance *own, const Stored *stored, unsigned char *bytes, size_t size)
{
  if (own == NULL || stored == NULL || bytes == NULL || size < sizeof *stored) {
    return refuse(own, "fmi3SerializeFMUState needs a state, and memory of its size");
  }
  memcpy(bytes, stored, sizeof *stored);
  return OK;
}

EXPORT Status fmi3DeserializeFMUState(
  Instance *own, const unsigned char *bytes, size_t size, Stored **stored)
{
  if (own == NULL || bytes == NULL || stored == NULL || size != sizeof **stored) {
    return refuse(own, "fmi3DeserializeFMUState: the bytes are not those of a state");
  }
  Stored *found = malloc(sizeof *found);
  if (found == NULL) {
    return ERROR;
  }
  memcpy(found, bytes, sizeof *found);
  if (found->size != sizeof *found || found->sum != sum_of(found)) {
    free(found);
    return refuse(own, "fmi3DeserializeFMUState: the bytes are not those of a state");
  }
  *stored = found;
  return OK;
}

/* Functions that this FMU does not offer return an error, or no instance; their arguments, which
   the caller passes, are not read. */
#define NO_INSTANCE(function) EXPORT Instance *function(void) { return NULL; }
#define NOT_OFFERED(function) \
  EXPORT Status function(const Instance *own) { return refuse(own, #function " is not offered"); }
NOT_OFFERED(fmi3GetFloat32) NOT_OFFERED(fmi3GetInt8) NOT_OFFERED(fmi3GetUInt8)
NOT_OFFERED(fmi3GetInt16) NOT_OFFERED(fmi3GetUInt16) NOT_OFFERED(fmi3GetInt32)
NOT_OFFERED(fmi3GetUInt32) NOT_OFFERED(fmi3GetInt64) NOT_OFFERED(fmi3GetUInt64)
NOT_OFFERED(fmi3GetBoolean) NOT_OFFERED(fmi3GetString) NOT_OFFERED(fmi3GetBinary)
NOT_OFFERED(fmi3GetClock) NOT_OFFERED(fmi3SetFloat32) NOT_OFFERED(fmi3SetInt8)
NOT_OFFERED(fmi3SetUInt8) NOT_OFFERED(fmi3SetInt16) NOT_OFFERED(fmi3SetUInt16)
NOT_OFFERED(fmi3SetInt32) NOT_OFFERED(fmi3SetUInt32) NOT_OFFERED(fmi3SetInt64)
NOT_OFFERED(fmi3SetUInt64) NOT_OFFERED(fmi3SetBoolean) NOT_OFFERED(fmi3SetString)
NOT_OFFERED(fmi3SetBinary) NOT_OFFERED(fmi3SetClock) NOT_OFFERED(fmi3GetIntervalDecimal)
NOT_OFFERED(fmi3GetIntervalFraction) NOT_OFFERED(fmi3GetShiftDecimal)
NOT_OFFERED(fmi3GetShiftFraction) NOT_OFFERED(fmi3SetIntervalDecimal)
NOT_OFFERED(fmi3SetIntervalFraction) NOT_OFFERED(fmi3SetShiftDecimal)
NOT_OFFERED(fmi3SetShiftFraction) NOT_OFFERED(fmi3EnterEventMode)
NOT_OFFERED(fmi3GetNumberOfVariableDependencies) NOT_OFFERED(fmi3GetVariableDependencies)
NOT_OFFERED(fmi3GetDirectionalDerivative) NOT_OFFERED(fmi3GetAdjointDerivative)
NOT_OFFERED(fmi3EnterConfigurationMode) NOT_OFFERED(fmi3ExitConfigurationMode)
NOT_OFFERED(fmi3EvaluateDiscreteStates) NOT_OFFERED(fmi3UpdateDiscreteStates)
NOT_OFFERED(fmi3EnterContinuousTimeMode) NOT_OFFERED(fmi3CompletedIntegratorStep)
NOT_OFFERED(fmi3SetTime) NOT_OFFERED(fmi3SetContinuousStates)
NOT_OFFERED(fmi3GetContinuousStateDerivatives) NOT_OFFERED(fmi3GetEventIndicators)
NOT_OFFERED(fmi3GetContinuousStates) NOT_OFFERED(fmi3GetNominalsOfContinuousStates)
NOT_OFFERED(fmi3GetNumberOfEventIndicators) NOT_OFFERED(fmi3GetNumberOfContinuousStates)
NOT_OFFERED(fmi3EnterStepMode) NOT_OFFERED(fmi3GetOutputDerivatives)
NOT_OFFERED(fmi3ActivateModelPartition) NO_INSTANCE(fmi3InstantiateModelExchange)
NO_INSTANCE(fmi3InstantiateScheduledExecution)
