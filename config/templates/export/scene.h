/* $title
   Steps of $step_size s with $integrator; compiled by hnn_vi_ros $version for $processor. */
#ifndef ${NAME}_H
#define ${NAME}_H

#include <stdint.h>

#ifdef __cplusplus
#define ${NAME}_ALIGNED alignas(64)
extern "C" {
#else
#define ${NAME}_ALIGNED _Alignas(64)
#endif

/* Step size h [s]. */
#define ${NAME}_STEP_SIZE $step_size

/* Statuses. After a failed step the state is that before the step. */
enum {
  ${NAME}_OK = 0,
  ${NAME}_NO_CONVERGENCE = 1,
  ${NAME}_NOT_FINITE = 2,
  ${NAME}_BEYOND = 3, /* the stability limit of an explicit method */
  ${NAME}_NO_MASS = 4, /* H_pp is not positive definite */
  ${NAME}_REDUNDANT = 5, /* a constraint depends on others */
  ${NAME}_NO_SOLUTION = 7, /* none is connected to h = 0 */
  ${NAME}_TURNED = 8, /* a body would rotate by almost pi rad or more in one step */
  ${NAME}_NOT_HELD = 9, /* no impulses satisfy the constraints over the step */
  ${NAME}_NO_IMPACT = 10, /* impacts cannot be resolved */
  ${NAME}_ENDLESS = 11, /* internal steps became too many or too short */
  ${NAME}_INVALID_COMMAND = 100, /* a number is out of range; nothing is changed */
  ${NAME}_INVALID_STATE = 101, /* it was saved by another object */
  ${NAME}_INTERNAL = 102, /* a formula divides by zero or has no value */
  ${NAME}_EVENT = 103 /* the last step taken had an event; the output time tells how many were */
};

/* Numbers of a command. */
enum {
$inputs
  ${NAME}_INPUTS
};

/* Outputs. */
enum {
$outputs
  ${NAME}_OUTPUTS
};

/* Numbers of the scene that can be changed. */
enum {
$parameters
  ${NAME}_PARAMETERS
};

enum { ${NAME}_Q_SIZE = $q_size, ${NAME}_P_SIZE = $p_size, ${NAME}_SAVED_WORDS = $saved };

/* State of one simulation, with its parameters and workspaces. It contains addresses in itself:
   copy it with save and restore. Functions may run at the same time on different states. */
typedef struct { ${NAME}_ALIGNED int64_t words[$words]; } ${name}_state;

/* Fill a state with the initial state of the scene. All other functions need a state that was
   filled before. */
int32_t ${name}_init(${name}_state *state);

/* After init: start from other q (${NAME}_Q_SIZE numbers) and conjugate momenta p
   (${NAME}_P_SIZE numbers). They must satisfy the loops and constraints of the scene. */
int32_t ${name}_start(${name}_state *state, const double *q, const double *p);

/* Change numbers of the scene (${NAME}_PARAMETERS numbers); NaN stands for the value in the scene.
   The energy changes by what this takes, which is no error of energy. */
int32_t ${name}_tune(${name}_state *state, const double *parameters);

/* Apply a command (${NAME}_INPUTS numbers), then take n steps. NaN leaves a number as it is, and
   a null pointer leaves all. A position or velocity acts until the next one, an effort for
   $timeout. An event ends the call after its step, with ${NAME}_EVENT. */
int32_t ${name}_step(${name}_state *state, const double *commands, int64_t n);

/* Return H(q, p) [J]; NaN if it fails. */
double ${name}_energy(${name}_state *state);

/* Fill the outputs (${NAME}_OUTPUTS numbers). */
int32_t ${name}_outputs(${name}_state *state, double *outputs);

/* Copy what changes in a state to memory of ${NAME}_SAVED_WORDS words, and back. The next steps
   are then the same, bit by bit. */
int32_t ${name}_save(${name}_state *state, int64_t *saved);
int32_t ${name}_restore(${name}_state *state, int64_t *saved);

#ifdef __cplusplus
}
#endif

#endif
