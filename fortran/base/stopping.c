/* Stop requests, and the unfinished file to remove if the program is terminated. Shared by the
   library and the limits of the driver. */
#define _GNU_SOURCE
#include <string.h>
#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#include <signal.h>
#include <sys/syscall.h>
#include <unistd.h>
#define HAS_SIGNALS
#endif

enum { longest = 4200 };

/* 0: continue. Set by the driver's alarm (app/limits.c). */
volatile int viscovib_stop = 0;
char viscovib_unfinished[longest] = "";

/* An empty name means no file. The first letter is written last, since an alarm may interrupt. */
void viscovib_set_unfinished(const char *path) {
  size_t n = strlen(path);
  viscovib_unfinished[0] = 0;
  if (n == 0 || n >= longest) return;
  memcpy(viscovib_unfinished + 1, path + 1, n);
  viscovib_unfinished[0] = path[0];
}

/* Current value of a flag. */
int viscovib_is_set(const volatile int *flag) { return *flag != 0; }

/* Stop flag of this thread, in addition to the flag of the program. Other threads set it. */
static _Thread_local const volatile int *listened = 0;

void viscovib_listen(const volatile int *flag) { listened = flag; }

/* Ctrl-C and similar signals during a call from Python's main thread. Python handles them only
   after the call. */
static volatile int interrupted = 0;
static _Thread_local int hears = 0;
/* 1 if the handlers of all signals are installed. */
static int hears_all = 0;

#ifdef HAS_SIGNALS
enum { n_signals = 4 };
static const int signals[n_signals] = {SIGINT, SIGTERM, SIGALRM, SIGHUP};
static struct sigaction others[n_signals];

static void hear(int number, siginfo_t *info, void *context) {
  int i;
  interrupted = 1;
  for (i = 0; i < n_signals; ++i) {
    if (signals[i] != number) continue;
    if (others[i].sa_flags & SA_SIGINFO) {
      others[i].sa_sigaction(number, info, context);
    } else {
      others[i].sa_handler(number);
    }
  }
}

/* 1 if the program has a handler for a signal. */
static int is_handled(const struct sigaction *action) {
  return (action->sa_flags & SA_SIGINFO)
         || (action->sa_handler != SIG_DFL && action->sa_handler != SIG_IGN);
}

/* Whether this thread is the main one; -1: not known. A fork makes its thread the main one. */
static _Thread_local int main_thread = -1;

static void forget_thread(void) { main_thread = -1; }

static int is_main_thread(void) {
#ifdef __APPLE__
  return pthread_main_np();
#else
  static int watches_forks = 0;
  if (main_thread < 0) {
    main_thread = syscall(SYS_gettid) == getpid();
    if (!watches_forks) watches_forks = !pthread_atfork(0, 0, forget_thread);
  }
  return main_thread;
#endif
}

/* Replace the handler of a signal that the program handles. */
static void take(int i) {
  struct sigaction own;
  memset(&own, 0, sizeof own);
  own.sa_sigaction = hear;
  own.sa_flags = SA_SIGINFO | SA_ONSTACK;
  sigemptyset(&own.sa_mask);
  sigaction(signals[i], 0, &others[i]);
  if (is_handled(&others[i])) sigaction(signals[i], &own, 0);
}

/* Let signals that the program handles also stop loops of this call, on the main thread only.
   Returns 1 if enabled. Short calls check no flag: only Ctrl-C is heard before the first check,
   because the handlers of all signals take as long as such a call. */
int viscovib_hear(void) {
  if (hears || !is_main_thread()) return 0;
  interrupted = hears_all = 0;
  take(0);
  hears = 1;
  return 1;
}

static void hear_all(void) {
  int i;
  for (i = 1; i < n_signals; ++i) take(i);
  hears_all = 1;
}

/* Restore the handlers after the call. Returns 1 if there was such a signal. */
int viscovib_heard(void) {
  int i;
  for (i = 0; i < (hears_all ? n_signals : 1); ++i) {
    if (is_handled(&others[i])) sigaction(signals[i], &others[i], 0);
  }
  hears = 0;
  return interrupted;
}
#else
static void hear_all(void) {}
int viscovib_hear(void) { return 0; }
int viscovib_heard(void) { return 0; }
#endif

/* 1 if the program or this thread must stop. */
int viscovib_stop_wanted(void) {
  if (hears && !hears_all) hear_all();
  return viscovib_stop != 0 || (listened && *listened != 0) || (hears && interrupted);
}
