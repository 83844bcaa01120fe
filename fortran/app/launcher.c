/* viscovib-solve in a wheel: executes the driver compiled for the instruction set of this machine.
   The drivers are in the same folder (viscovib-solve-x86-64-v2 and others). */
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static const char *level(void) {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("x86-64-v4")) return "x86-64-v4";
  if (__builtin_cpu_supports("x86-64-v3")) return "x86-64-v3";
#endif
  return "x86-64-v2";
}

int main(int argc, char **argv) {
  char path[4096];
  ssize_t n = readlink("/proc/self/exe", path, sizeof path - 32);
  (void)argc;
  if (n > 0) {
    path[n] = 0;
    strcpy(path + n, "-");
    strcat(path, level());
    execv(path, argv);
  }
  fprintf(stderr, "viscovib-solve: %s: %s\n", path, strerror(errno));
  return 3;
}
