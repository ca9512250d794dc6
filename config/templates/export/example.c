/* Print the outputs of a trajectory as CSV: example [STEPS [EVERY]]. */
#include <stdio.h>
#include <stdlib.h>

#include "${name}.h"

static const char *const names[] = {$names};

int main(int argc, char **argv)
{
  static ${name}_state state;
  double outputs[${NAME}_OUTPUTS];
  long steps = argc > 1 ? atol(argv[1]) : 1000, every = argc > 2 ? atol(argv[2]) : 100;
  int32_t status = ${name}_init(&state);
  for (int k = 0; k < ${NAME}_OUTPUTS; ++k) {
    printf("%s%c", names[k], k + 1 < ${NAME}_OUTPUTS ? ',' : '\n');
  }
  for (long done = 0; status == ${NAME}_OK; done += every) {
    status = ${name}_outputs(&state, outputs);
    for (int k = 0; k < ${NAME}_OUTPUTS; ++k) {
      printf("%.17g%c", outputs[k], k + 1 < ${NAME}_OUTPUTS ? ',' : '\n');
    }
    if (done >= steps || every < 1) {
      return 0;
    }
    if (status == ${NAME}_OK) {
      status = ${name}_step(&state, NULL, every);
    }
  }
  fprintf(stderr, "status %d\n", (int)status);
  return 1;
}
