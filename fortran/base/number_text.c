/* Numbers as text with 17 digits, by the C library. */
#include <stdio.h>
#include <string.h>

/* "-1.2345678901234567e+100" is the longest; a Fortran text has no end mark. */
void viscovib_format(double value, char *text, int *length) {
  char buffer[32];
  *length = snprintf(buffer, sizeof buffer, "%.16e", value);
  memcpy(text, buffer, (size_t)*length);
}
