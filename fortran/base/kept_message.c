/* The message of the call that failed last on this thread. f2py returns texts of a fixed length
   only, so a caller that sees a failure asks how long it is, makes room and takes it; programs in C
   read it where it is (viscovib_message). */
#include <stdlib.h>
#include <string.h>

static _Thread_local char *kept = NULL;
static _Thread_local int length = 0;

void viscovib_keep_message(const char *text, int n) {
  free(kept);
  kept = malloc((size_t)n + 1);
  length = kept ? n : 0;
  if (kept) {
    memcpy(kept, text, (size_t)n);
    kept[n] = 0;
  }
}

int viscovib_kept_length(void) { return length; }

/* Room has at least the kept length; nothing is kept afterwards. */
void viscovib_take_message(char *room) {
  if (kept) memcpy(room, kept, (size_t)length);
  free(kept);
  kept = NULL;
  length = 0;
}

/* Until the next call that fails; empty if none did. */
const char *viscovib_message(void) { return kept ? kept : ""; }
