/* Members of an ensemble: march, estimate and verdict, one after the other.

   What every check passes is accepted; all other members are left to the caller, who solves them with
   Newton's method and repeated marches. A member is computed by itself, so that its numbers do not depend
   on the others. */

#include "errors.h"
#include "models.h"
#include <stdlib.h>

#define ATTEMPTS 3        /* marches of a member, each to a tighter local tolerance */
#define SPLITTER 134217729.0 /* 2**27 + 1 */

enum verdict { ACCEPTED, LEFT };

/* What the members of one H share. Without the tables of bounds no window needs one. */
typedef struct {
  const equations *H;
  const tables *t;
  const error_tables *e;
  const actions *a;
  const bound_tables *b;
  int64_t width, period; /* numbers in a row of signs; windows with kicks of their own */
  const double *sign, *disturbance, *kick;
  double local; /* local tolerance of the first march */
  /* Of the local tolerance from one march to the next: share of the allowed error at which it aims, and limits of
     the step; below the smallest one residuals are round-off. */
  double margin, least_step, most_step, smallest;
  double tighter;           /* excess that marked windows count as, at least */
  double accuracy, fewest;  /* of the vectors of the error after all windows, and the least number of these */
} shared;

/* Times are relative to the origin. */
typedef struct {
  double start, end, tolerance, longest, shortest;
  const double *absolute; /* absolute tolerance, dim */
} span;

/* Results in consecutive rows: edges and states of a member begin after those of the members before it. */
typedef struct {
  int64_t members, room, readout;
  int64_t *count, *verdict, *evaluations;
  double *excess, *largest, *size, *edge, *state, *coefficient;
  int64_t *mark;
  double *series, *floor; /* or null */
} members;

/* Four numbers, or the last two of an even number of them. */
INLINE v4 load_some(const double *p, long left) { return left < 4 ? (v4){p[0], p[1]} : load4(p); }

/* The rounding of the state at each joint, with twice the digits. */
static void joint_errors(const windows *w, const tables *t, long dim, long count, double *out) {
  for (long k = 0; k < count; k++)
    for (long i = 0; i < dim; i += 4) {
      long left = dim - i;
      v4 total = load_some(w->state + k * dim + i, left), rest = spread4(0.0);
      for (long m = 0; m < w->readout; m++) {
        v4 a = load_some(w->coefficient + (k * w->readout + m) * dim + i, left), b = spread4(t->end[m]), product = a * b;
        /* The rounding error of the product (Dekker), and of the sum (Knuth). */
        v4 c = SPLITTER * a, high_a = c - (c - a), low_a = a - high_a;
        c = SPLITTER * b;
        v4 high_b = c - (c - b), low_b = b - high_b;
        v4 lost = low_a * low_b - (((product - high_a * high_b) - low_a * high_b) - high_a * low_b);
        v4 added = total + product, part = added - total;
        rest += (total - (added - part)) + (product - part) + lost;
        rest += a * spread4(t->end_low[m]);
        total = added;
      }
      v4 found = (total - load_some(w->state + (k + 1) * dim + i, left)) + rest;
      memcpy(out + k * dim + i, &found, (left < 4 ? 2 : 4) * sizeof *out);
    }
}

/* Whether H changes in no window by more than the local tolerance explains. */
static int keeps_energy(machine *energy, marching *m, const equations *H, const windows *w, long count,
                        double tolerance, const double *size) {
  long dim = H->dim;
  /* Eight edges at a time, the first of which is the last of those before. */
  for (long first = 0; first < count; first += 7) {
    double *rows = m->disturbed, *slopes = rows + 8 * dim, times[8], energies[8];
    for (long c = 0; c < 8; c++) {
      long k = first + c < count ? first + c : count;
      times[c] = w->edge[k];
      for (long i = 0; i < dim; i++) rows[i * 8 + c] = w->state[k * dim + i];
    }
    run(energy, rows, times, 8, energies);
    /* The gradient of H is the vector field with its halves exchanged, up to signs. */
    run(&m->velocity, rows, times, 8, slopes + dim / 2 * 8);
    run(&m->force, rows, times, 8, slopes);
    for (long c = 0; c < 7 && first + c < count; c++) {
      double allowed = 0.0, rounding = fabs(energies[c]);
      for (long i = 0; i < dim; i++) {
        double slope = larger(fabs(slopes[i * 8 + c]), fabs(slopes[i * 8 + c + 1]));
        allowed += slope * size[i];
        rounding += slope * larger(fabs(rows[i * 8 + c]), fabs(rows[i * 8 + c + 1]));
      }
      allowed = SLACK * (tolerance * allowed + ROUND_OFF * rounding);
      if (!(fabs(energies[c + 1] - energies[c]) <= allowed && allowed < INFINITY)) return 0;
    }
  }
  return 1;
}

/* Solve members until the room for windows is full; return how many were solved, -1 without memory. Windows that are
   not bounded are left to the caller, with a mark. */
EXPORTED int64_t hamsym_members(const shared *all, const span *span, const double *starts, const double *parameters,
                                members *r) {
  const equations *H = all->H;
  const tables *t = all->t;
  const error_tables *e = all->e;
  const actions *a = all->a;
  const bound_tables *b = all->b;
  long dim = H->dim, many = H->velocity->parameters, vectors = dim * (e->perturbations + 2);
  marching m;
  carrying c;
  bounding bounds;
  machine energy;
  double *found, *tail, *floors, *scale, *joint, *jumps, *rates;
  arena arena = {0};
  for (int turn = 0; turn < 2; turn++) { /* count, then lay out */
    lay_out_march(&m, &arena, H, t);
    lay_out_errors(&c, &arena, H, e, a);
    if (b) lay_out_bounds(&bounds, &arena, H, b);
    if (H->energy) take_machine(&arena, &energy, H->energy, 8);
    found = take(&arena, dim * t->nodes);
    tail = take(&arena, dim * t->terms);
    floors = take(&arena, dim);
    scale = take(&arena, dim);
    joint = take(&arena, vectors);
    rates = take(&arena, 8 * dim);
    jumps = take(&arena, r->room * dim);
    if (!arena.memory && !allocate(&arena)) return -1;
  }
  double clock[3], history[2], stop = span->end, whole = fabs(span->end - span->start);
  int64_t counts[4];
  long done = 0, member = 0;
  for (; member < r->members; member++) {
    const double *z = starts + member * dim, *values = parameters + member * many;
    long first = done + member;
    windows w = {r->room - done, r->readout, r->edge + first, r->state + first * dim,
                 r->coefficient + done * r->readout * dim};
    double *size = r->size + member * dim, *largest = r->largest + member * dim;
    settings s = {1, all->width, 1, all->local, span->shortest, span->longest, &stop, floors, all->sign, values};
    progress p = {clock, counts, size, tail, found};
    set_parameters(&m.velocity, values, m.stride);
    set_parameters(&m.force, values, m.stride);
    for (long i = 0; i < dim; i++) fill(m.disturbed + i * 8, z[i], 8);
    fill(m.late, span->start, 8);
    evaluate(&m.velocity, &m.force, m.disturbed, m.late, 8, rates);
    int finite = 1;
    for (long i = 0; i < dim; i++) {
      rates[i] = rates[i * 8];
      finite &= fabs(rates[i]) < INFINITY;
    }
    double length = first_length(&m, H, z, rates, span->start, span->end), excess = INFINITY;
    enum verdict verdict = LEFT;
    long count = 0, evaluations = 2;
    int full = 0;
    for (int attempt = 0; finite && attempt < ATTEMPTS; attempt++) {
      w.edge[0] = clock[0] = span->start;
      clock[1] = length;
      clock[2] = 0.0;
      counts[0] = counts[2] = 0;
      counts[1] = evaluations;
      counts[3] = -PAUSE;
      memset(tail, 0, dim * t->terms * sizeof(double));
      for (long i = 0; i < dim; i++) {
        w.state[i] = z[i];
        size[i] = fabs(z[i]);
        tail[i * t->terms] = rates[i];
      }
      int outcome = march(&m, H, t, &s, &p, &w, 0);
      evaluations = counts[1];
      count = counts[0];
      full = outcome == FULL;
      if (outcome != FINISHED) break;
      double squares = 0.0;
      for (long k = 0; k < count; k++) squares += (w.edge[k + 1] - w.edge[k]) * (w.edge[k + 1] - w.edge[k]);
      for (long i = 0; i < dim; i++) scale[i] = size[i] > 0.0 ? size[i] : 1.0;
      error_settings es = {all->period, 0, s.tolerance, all->accuracy / greater(count, all->fewest), squares / whole,
                           scale, size, all->disturbance, all->kick, values, 0, 0};
      error_results er = {joint, history, r->series ? r->series + done * e->places * dim : 0,
                          r->floor ? r->floor + done * dim : 0, largest, r->mark + done};
      joint_errors(&w, t, dim, count, jumps);
      memset(joint, 0, vectors * sizeof(double));
      memset(largest, 0, dim * sizeof(double));
      history[0] = history[1] = 0.0;
      long next = 0;
      if (carry_errors(&c, H, e, a, &es, &w, jumps, &er, &next, count) != DONE) break;
      excess = 0.0;
      for (long i = 0; i < dim; i++) {
        double allowed = greater(span->absolute[i] + span->tolerance * size[i], TINY);
        if (largest[i] != 0.0) excess = larger(largest[i] / allowed, excess);
      }
      int marked = 0;
      for (long k = 0; k < count; k++) marked |= er.mark[k];
      if (marked) excess = larger(all->tighter, excess);
      if (excess <= 1.0) {
        int good = 1;
        if (H->energy) {
          set_parameters(&energy, values, 8);
          good = keeps_energy(&energy, &m, H, &w, count, s.tolerance, size);
        }
        if (good) verdict = ACCEPTED;
        for (long k = 0; good && b && k < count; k++)
          if (!is_bounded(&bounds, H, b, all->local, w.edge[k], w.edge[k + 1], w.state + k * dim,
                          w.coefficient + k * w.readout * dim, w.readout, size, values))
            er.mark[k] |= UNBOUNDED;
        break;
      }
      if (s.tolerance <= all->smallest || !(excess < INFINITY)) break;
      double step = lesser(greater(all->margin / excess, all->least_step), all->most_step);
      s.tolerance = greater(s.tolerance * step, all->smallest);
    }
    if (full) break;
    if (verdict == LEFT) count = 0;
    r->count[member] = count;
    r->verdict[member] = verdict;
    r->evaluations[member] = evaluations;
    r->excess[member] = excess;
    done += count;
  }
  if (b) free(bounds.row);
  free(arena.whole);
  return member;
}

/* -- one march, step by step ------------------------------------------------------------------- */

/* Lay out a march in new memory; return whether there is some. */
static int set_up(marching *m, arena *arena, const equations *H, const tables *t) {
  lay_out_march(m, arena, H, t);
  if (!allocate(arena)) return 0;
  lay_out_march(m, arena, H, t);
  return 1;
}

/* Fill windows; see march.h. */
EXPORTED int64_t hamsym_march(const equations *H, const tables *t, const settings *s, progress *p, windows *w,
                              int64_t given) {
  marching m;
  arena arena = {0};
  if (!set_up(&m, &arena, H, t)) return NO_MEMORY;
  int outcome = march(&m, H, t, s, p, w, given);
  free(arena.whole);
  return outcome;
}

/* Estimate the error of windows; `first` becomes the first that is not estimated; see errors.h. */
EXPORTED int64_t hamsym_errors(const equations *H, const error_tables *e, const actions *a, const error_settings *s,
                               const windows *w, const tables *t, error_results *r, int64_t *first, int64_t end) {
  carrying c;
  arena arena = {0};
  double *jumps;
  for (int turn = 0; turn < 2; turn++) {
    lay_out_errors(&c, &arena, H, e, a);
    jumps = take(&arena, end * H->dim);
    if (!arena.memory && !allocate(&arena)) return NO_ROOM;
  }
  joint_errors(w, t, H->dim, end, jumps);
  long next = *first;
  int outcome = carry_errors(&c, H, e, a, s, w, jumps, r, &next, end);
  *first = next;
  free(arena.whole);
  return outcome;
}

/* Length of the first window of a march from z. */
EXPORTED double hamsym_first_length(const equations *H, const tables *t, const double *parameters, const double *z,
                                    const double *rates, double start, double end) {
  marching m;
  arena arena = {0};
  if (!set_up(&m, &arena, H, t)) return 0.0;
  set_parameters(&m.velocity, parameters, m.stride);
  set_parameters(&m.force, parameters, m.stride);
  double found = first_length(&m, H, z, rates, start, end);
  free(arena.whole);
  return found;
}

/* Values of a program at n states, n a multiple of eight. */
EXPORTED int64_t hamsym_run(const program *p, const double *parameters, const double *states, const double *times,
                            int64_t n, double *out) {
  double *memory = calloc(machine_size(p, n), sizeof(double));
  if (!memory) return 0;
  machine m;
  make_machine(&m, p, memory, n);
  set_parameters(&m, parameters, n);
  run(&m, states, times, n, out);
  free(memory);
  return 1;
}

/* Changes of the values of a program, at n states in each group, where the results of operations are rounded otherwise:
   by chance, and alike at all states. n is a multiple of eight; a row of n signs belongs to each step. */
EXPORTED int64_t hamsym_roundings(const program *p, const double *parameters, const double *states, const double *times,
                                  int64_t groups, int64_t n, const double *signs, double *changing, double *steady) {
  long size = machine_size(p, n), values = p->results * n;
  double *memory = calloc(size + values, sizeof(double)), *usual = memory + size;
  if (!memory) return 0;
  machine m;
  make_machine(&m, p, memory, n);
  for (long k = 0; k < groups; k++, states += p->dim * n, times += n, changing += values, steady += values) {
    set_parameters(&m, parameters + k * p->parameters, n);
    run(&m, states, times, n, usual);
    /* Beside the edge of a domain, as of a root, magnified roundings may leave it. */
    int finite = 0;
    for (double factor = MAGNIFIED; !finite && factor >= 1.0; factor /= MAGNIFIED) {
      run_disturbed(&m, states, times, n, signs, factor * SPREAD, changing);
      run_shifted(&m, states, times, n, signs, factor, steady);
      finite = 1;
      for (long c = 0; c < values; c++) {
        changing[c] = (changing[c] - usual[c]) / factor;
        steady[c] = (steady[c] - usual[c]) / factor;
        finite = finite && fabs(changing[c]) < INFINITY && fabs(steady[c]) < INFINITY;
      }
    }
  }
  free(memory);
  return 1;
}
