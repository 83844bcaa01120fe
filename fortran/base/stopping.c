/* What bounds on a whole program share with the library: whether it shall stop, and the file in the
   making, to be removed if it ends at once. */
#include <string.h>

enum { longest = 4200 };

/* 0: go on. Set by the driver's alarm (app/limits.c). */
volatile int viscovib_stop = 0;
char viscovib_unfinished[longest] = "";

/* The empty name: none. Its first letter comes last, since an alarm may come between. */
void viscovib_set_unfinished(const char *path) {
  size_t n = strlen(path);
  viscovib_unfinished[0] = 0;
  if (n == 0 || n >= longest) return;
  memcpy(viscovib_unfinished + 1, path + 1, n);
  viscovib_unfinished[0] = path[0];
}

/* A flag as it is now. */
int viscovib_is_set(const volatile int *flag) { return *flag != 0; }

/* The flag that this thread listens to, besides that of the whole program. Other threads set it. */
static _Thread_local const volatile int *listened = 0;

void viscovib_listen(const volatile int *flag) { listened = flag; }

/* Whether the whole program or this thread shall stop. */
int viscovib_stop_wanted(void) { return viscovib_stop != 0 || (listened && *listened != 0); }
