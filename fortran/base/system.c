/* All POSIX functions that the library uses; the limits of the driver are in app/limits.c.

   Files are opened with options that Fortran lacks: regular files only, names with trailing blanks,
   no links followed when a file is created. Failures return the negative errno, or not_regular for
   an object that is not a regular file. */
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { not_regular = -100000 };

/* Open a regular file and return its size. Does not wait for a pipe. */
int viscovib_open_to_read(const char *path, int64_t *size) {
  struct stat found;
  char byte;
  int file = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC | O_NOCTTY);
  *size = 0;
  if (file < 0) return -errno;
  if (fstat(file, &found) != 0) {
    int why = -errno;
    close(file);
    return why;
  }
  /* Virtual files that the system generates on reading report a size of 0. */
  if (S_ISDIR(found.st_mode) || !S_ISREG(found.st_mode) ||
      (found.st_size == 0 && pread(file, &byte, 1, 0) == 1)) {
    close(file);
    return S_ISDIR(found.st_mode) ? -EISDIR : not_regular;
  }
  *size = found.st_size;
  return file;
}

/* Read `size` bytes and close the file. Returns 0 or an error code. */
int viscovib_read_and_close(int file, char *text, int64_t size) {
  int64_t done = 0;
  int why = 0;
  while (done < size && why == 0) {
    ssize_t n = read(file, text + done, (size_t)(size - done));
    if (n > 0) done += n;
    else if (n == 0) why = -EIO;
    else if (errno != EINTR) why = -errno;
  }
  close(file);
  return why;
}

/* Write to standard output without buffering. Returns 0 or an error code. Fortran output statements
   do not report a full disk. */
int viscovib_print(const char *text, int n) {
  while (n > 0) {
    ssize_t written = write(STDOUT_FILENO, text, (size_t)n);
    if (written < 0 && errno != EINTR) return -errno;
    if (written <= 0) continue;
    text += written;
    n -= (int)written;
  }
  return 0;
}

void viscovib_close(int file) { close(file); }

/* Create a file for writing. An existing file of this name is removed first; a link is not
   followed. */
FILE *viscovib_open_to_write(const char *path, int *why) {
  struct stat found;
  FILE *stream;
  int file;
  *why = 0;
  if (lstat(path, &found) == 0 && S_ISDIR(found.st_mode)) {
    *why = -EISDIR;
    return NULL;
  }
  unlink(path);
  file = open(path, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
  stream = file < 0 ? NULL : fdopen(file, "w");
  if (stream == NULL) {
    *why = -errno;
    if (file >= 0) close(file);
  }
  return stream;
}

/* Flush and close. Returns 0 or an error code. */
int viscovib_close_written(FILE *stream, int failed_before) {
  int why = failed_before;
  if (fclose(stream) != 0 && why == 0) why = -errno;
  return why;
}

int viscovib_write(const char *text, int64_t n, FILE *stream) {
  errno = 0;
  if (fwrite(text, 1, (size_t)n, stream) == (size_t)n) return 0;
  return errno != 0 ? -errno : -EIO;
}

/* Text of an error code. Returns its length. */
int viscovib_reason(int code, char *text, int room) {
  const char *words = code == not_regular ? "not a regular file" : strerror(-code);
  int n = (int)strlen(words);
  if (n > room) n = room;
  memcpy(text, words, (size_t)n);
  return n;
}

/* Path with links and dots resolved. Returns its length, 0 if the file does not exist. */
int viscovib_real_path(const char *path, char *text, int room) {
  char *found = realpath(path, NULL);
  int n = found == NULL ? 0 : (int)strlen(found);
  if (n > room) n = 0;
  if (n > 0) memcpy(text, found, (size_t)n);
  free(found);
  return n;
}

/* Make exceeding the file size limit a write error instead of terminating the program. */
void viscovib_ignore_file_limit(void) { signal(SIGXFSZ, SIG_IGN); }

/* Returns 0, or another value if the folder exists or cannot be created. */
int viscovib_make_folder(const char *path) { return mkdir(path, 0777); }

/* Rename atomically. Returns 0 if successful. A link is replaced; a device, a pipe or a link to one
   is an error. */
int viscovib_replace(const char *from, const char *to) {
  struct stat found;
  if (stat(to, &found) == 0 && !S_ISREG(found.st_mode) && !S_ISDIR(found.st_mode)) return -1;
  return rename(from, to);
}

/* Lock for FFTW plans, which only one thread may create at a time. Fortran has no portable lock,
   and Python's lock is released during the harmonic balance of a pendulum. */
static pthread_mutex_t planner = PTHREAD_MUTEX_INITIALIZER;

void viscovib_lock_planner(void) { pthread_mutex_lock(&planner); }

void viscovib_unlock_planner(void) { pthread_mutex_unlock(&planner); }

/* Lock for the list of objects with handles. */
static pthread_mutex_t handles = PTHREAD_MUTEX_INITIALIZER;

void viscovib_lock_handles(void) { pthread_mutex_lock(&handles); }

void viscovib_unlock_handles(void) { pthread_mutex_unlock(&handles); }

/* Lock for texts of deferred length, since gfortran keeps the lengths of such function results in
   static memory. The lock is recursive. */
static pthread_mutex_t texts;
static pthread_once_t texts_made = PTHREAD_ONCE_INIT;

static void make_texts(void) {
  pthread_mutexattr_t kind;
  pthread_mutexattr_init(&kind);
  pthread_mutexattr_settype(&kind, PTHREAD_MUTEX_RECURSIVE);
  pthread_mutex_init(&texts, &kind);
  pthread_mutexattr_destroy(&kind);
}

void viscovib_lock_texts(void) {
  pthread_once(&texts_made, make_texts);
  pthread_mutex_lock(&texts);
}

void viscovib_unlock_texts(void) { pthread_mutex_unlock(&texts); }
