/* One thread at a time makes plans: FFTW allows no more. Fortran has no lock that works on every
   system, and Python's is not held where the balance of a pendulum runs. */
#include <pthread.h>

static pthread_mutex_t planner = PTHREAD_MUTEX_INITIALIZER;

void viscovib_lock_planner(void) { pthread_mutex_lock(&planner); }

void viscovib_unlock_planner(void) { pthread_mutex_unlock(&planner); }
