/* The message of the last failed call on this thread. f2py returns only texts of a fixed length, so
   a caller gets the length of the message, allocates memory and copies the message. C programs read
   it directly (viscovib_message). */
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

/* Copy the message to `room`, which has at least the kept length, and delete it. */
void viscovib_take_message(char *room) {
  if (kept) memcpy(room, kept, (size_t)length);
  free(kept);
  kept = NULL;
  length = 0;
}

/* Valid until the next failed call; empty if no call has failed. */
const char *viscovib_message(void) { return kept ? kept : ""; }
