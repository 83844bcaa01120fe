/* A lock for tables shared by threads, which work without the table if the lock is taken. */
#include <stdatomic.h>

static atomic_flag taken = ATOMIC_FLAG_INIT;

int viscovib_take_lock(void) { return !atomic_flag_test_and_set_explicit(&taken, memory_order_acquire); }

void viscovib_release_lock(void) { atomic_flag_clear_explicit(&taken, memory_order_release); }
