/* Limits on time and memory of the program. At the time limit, computations stop with partial
   results (their loops check viscovib_stop); otherwise the program is terminated after a grace
   period. A failed allocation terminates the program at once. Termination prints one line, removes
   the unfinished file, and returns the exit status 1. */
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/time.h>
#include <unistd.h>

extern volatile int viscovib_stop;
extern char viscovib_unfinished[];

static char time_message[200] = "viscovib-solve: stopped: time is over\n";
static char memory_message[300] = "viscovib-solve: stopped: no more memory\n";
static double grace = 1.0;

static void end_now(const char *message) {
  ssize_t ignored;
  if (viscovib_unfinished[0]) unlink(viscovib_unfinished);
  ignored = write(STDERR_FILENO, message, strlen(message));
  (void)ignored;
  _exit(1);
}

static void set_timer(double seconds) {
  struct itimerval timer;
  memset(&timer, 0, sizeof timer);
  timer.it_value.tv_sec = (time_t)seconds;
  timer.it_value.tv_usec = (suseconds_t)((seconds - (double)timer.it_value.tv_sec) * 1e6);
  setitimer(ITIMER_REAL, &timer, NULL);
}

static void at_alarm(int number) {
  (void)number;
  /* Do not interrupt the writing of results. */
  if (viscovib_stop && !viscovib_unfinished[0]) end_now(time_message);
  viscovib_stop = 1;
  set_timer(grace);
}

/* Start the time limit. The grace period is a quarter of it, at least three seconds. */
void viscovib_limit_seconds(double seconds) {
  struct sigaction action;
  grace = seconds < 12.0 ? 3.0 : 0.25 * seconds;
  snprintf(time_message, sizeof time_message,
           "viscovib-solve: stopped: %g s are over (--max-seconds), nothing is finished\n", seconds);
  memset(&action, 0, sizeof action);
  action.sa_handler = at_alarm;
  action.sa_flags = SA_RESTART;
  sigaction(SIGALRM, &action, NULL);
  set_timer(seconds);
}

/* Raise the stack limit, up to the hard limit. */
__attribute__((constructor)) static void need_stack(void) {
  struct rlimit limit;
  const rlim_t wanted = 8u << 20, least = 1u << 20;
  char message[200];
  ssize_t ignored;
  if (getrlimit(RLIMIT_STACK, &limit) != 0) return;
  if (limit.rlim_cur == RLIM_INFINITY || limit.rlim_cur >= wanted) return;
  limit.rlim_cur = limit.rlim_max == RLIM_INFINITY || limit.rlim_max > wanted ? wanted : limit.rlim_max;
  setrlimit(RLIMIT_STACK, &limit);
  if (limit.rlim_cur >= least) return;
  snprintf(message, sizeof message,
           "viscovib-solve: the limit of the stack is %lu kB, must be at least 1024 kB (ulimit -s)\n",
           (unsigned long)(limit.rlim_cur >> 10));
  ignored = write(STDERR_FILENO, message, strlen(message));
  (void)ignored;
  _exit(2);
}

/* Memory available to this program: that of the machine or of its control group. */
static double available(void) {
  double most = (double)sysconf(_SC_PHYS_PAGES) * (double)sysconf(_SC_PAGESIZE), bound;
  FILE *file = fopen("/sys/fs/cgroup/memory.max", "r");
  if (file != NULL) {
    if (fscanf(file, "%lf", &bound) == 1 && bound > 0 && bound < most) most = bound;
    fclose(file);
  }
  return most;
}

/* Limit in bytes; 0: three quarters of the available memory. With more, the system would swap for
   hours or kill this or another program. */
void viscovib_limit_memory(double bytes) {
  struct rlimit limit;
  if (bytes <= 0.0) bytes = 0.75 * available();
  snprintf(memory_message, sizeof memory_message,
           "viscovib-solve: stopped: more than %.3g GB of memory are needed (--max-memory); ask for "
           "less: fewer points, harmonics or states kept\n", bytes / 1e9);
#if !defined(__SANITIZE_ADDRESS__)
  if (getrlimit(RLIMIT_DATA, &limit) != 0) return;
  if (limit.rlim_cur != RLIM_INFINITY && (double)limit.rlim_cur <= bytes) return;
  if (bytes < 9e18) limit.rlim_cur = (rlim_t)bytes;
  setrlimit(RLIMIT_DATA, &limit);
#else
  (void)limit;
#endif
}

/* Replace malloc, calloc and realloc in Fortran code of the driver (link option --wrap). */
void *__real_malloc(size_t n);
void *__real_calloc(size_t n, size_t size);
void *__real_realloc(void *old, size_t n);
void *__wrap_malloc(size_t n);
void *__wrap_calloc(size_t n, size_t size);
void *__wrap_realloc(void *old, size_t n);

void *__wrap_malloc(size_t n) {
  void *found = __real_malloc(n);
  if (found == NULL && n > 0) end_now(memory_message);
  return found;
}

void *__wrap_calloc(size_t n, size_t size) {
  void *found = __real_calloc(n, size);
  if (found == NULL && n > 0 && size > 0) end_now(memory_message);
  return found;
}

void *__wrap_realloc(void *old, size_t n) {
  void *found = __real_realloc(old, n);
  if (found == NULL && n > 0) end_now(memory_message);
  return found;
}
