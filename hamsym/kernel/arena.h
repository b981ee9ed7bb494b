/* Memory of doubles that is counted, allocated, and laid out in the same order. Parts begin where a line of the cache
   does, so that no vector crosses one. */

#ifndef HAMSYM_ARENA_H
#define HAMSYM_ARENA_H

#include "rows.h"
#include <stdlib.h>

/* Doubles in a memory, or their number if there is no memory yet. */
typedef struct { double *memory; long used; void *whole; } arena;

static inline double *take(arena *arena, long count) {
  double *found = arena->memory ? arena->memory + arena->used : 0;
  arena->used += (count + LINE - 1) / LINE * LINE;
  return found;
}

/* Make a memory of zeros for what was taken, which is to be taken again; return whether there is one. */
static inline int allocate(arena *arena) {
  if (!(arena->whole = calloc(arena->used + LINE, sizeof(double)))) return 0;
  arena->memory = (double *)(((uintptr_t)arena->whole / sizeof(double) + LINE) / LINE * LINE * sizeof(double));
  arena->used = 0;
  return 1;
}

#endif
