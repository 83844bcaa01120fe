/* Numbers as text with 17 digits, by the C library. */
#include <stdio.h>
#include <string.h>

static int is_digit(char c) { return c >= '0' && c <= '9'; }

/* The longest text is "-1.2345678901234567e+100", without a terminating null. The decimal separator
   is a point in every locale. */
void viscovib_format(double value, char *text, int *length) {
  char buffer[40], *point, *rest;
  snprintf(buffer, sizeof buffer, "%.16e", value);
  point = buffer + (buffer[0] == '-');
  if (is_digit(*point) && point[1] != '.') {
    rest = ++point;
    while (!is_digit(*rest)) rest++;
    *point = '.';
    memmove(point + 1, rest, strlen(rest) + 1);
  }
  *length = (int)strlen(buffer);
  memcpy(text, buffer, (size_t)*length);
}
