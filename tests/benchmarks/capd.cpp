// Validated integration by CAPD, beside which the certificates of hamsym can be put.
//
// The program prints one line of JSON for one problem: the widths of CAPD's enclosure of the true
// state at the end of the span and the CPU time of the integration, for some orders, tolerances and
// representations of sets. Nothing else of the repository needs it; CAPD 6.1 is a library in C++,
// https://github.com/CAPDGroup/CAPD, built in a folder BUILD by
//
//     cmake SOURCE -DCMAKE_BUILD_TYPE=Release && make
//
// and the program by
//
//     g++ capd.cpp -o capd $(BUILD/bin/capd-config --cflags --libs)
//
// ./capd without arguments lists the problems, ./capd NAME measures one.

#include <algorithm>
#include <cfenv>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "capd/capdlib.h"

using capd::autodiff::Node;
using capd::IMatrix;
using capd::IVector;
using Field = void (*)(Node, Node[], int, Node[], int, Node[], int);

// Fields: Hamilton's equations, state (q, p), which for unit masses is (q, velocity). All constants
// are exact doubles.

void oscillator(Node, Node z[], int, Node out[], int, Node[], int)
{
  out[0] = z[1];
  out[1] = -z[0];
}

void pendulum(Node, Node z[], int, Node out[], int, Node[], int)
{
  out[0] = z[1];
  out[1] = -sin(z[0]);
}

void henon_heiles(Node, Node z[], int, Node out[], int, Node[], int)
{
  out[0] = z[2];
  out[1] = z[3];
  out[2] = -z[0] * (1 + 2 * z[1]);
  out[3] = sqr(z[1]) - z[1] - sqr(z[0]);
}

void kepler(Node, Node z[], int, Node out[], int, Node[], int)
{
  Node factor = (sqr(z[0]) + sqr(z[1])) ^ -1.5;
  out[0] = z[2];
  out[1] = z[3];
  out[2] = -z[0] * factor;
  out[3] = -z[1] * factor;
}

// Seven bodies in the plane with masses 1, ..., 7: Hairer, Norsett & Wanner 1993, section II.10.
// The state is (x_1..x_7, y_1..y_7, velocities): with momenta the enclosures are far wider.
void pleiades(Node, Node z[], int, Node out[], int, Node[], int)
{
  const int n = 7;
  bool first[n] = {true, true, true, true, true, true, true};
  for (int i = 0; i < n; ++i) {
    out[i] = z[2 * n + i];
    out[n + i] = z[3 * n + i];
  }
  for (int i = 0; i < n; ++i)
    for (int j = i + 1; j < n; ++j) {
      Node dx = z[j] - z[i], dy = z[n + j] - z[n + i];
      Node factor = (sqr(dx) + sqr(dy)) ^ -1.5;
      Node pull[2] = {dx * factor, dy * factor};
      for (int axis = 0; axis < 2; ++axis) {
        Node &mine = out[(2 + axis) * n + i], &other = out[(2 + axis) * n + j];
        Node gain = double(j + 1) * pull[axis], loss = double(i + 1) * pull[axis];
        mine = first[i] ? gain : mine + gain;
        other = first[j] ? -loss : other - loss;
      }
      first[i] = first[j] = false;
    }
}

struct Problem {
  Field field;
  std::vector<double> start;
  double end;          // of the span
  bool reach = false;  // the last times with widths below REACHES are sought, up to `end`
};

// 4 pi and 6 pi are the doubles that 4*math.pi and 6*math.pi are in Python.
const double FOUR_PI = 12.566370614359172, SIX_PI = 18.84955592153876;

const std::map<std::string, Problem> PROBLEMS = {
  {"oscillator", {oscillator, {1, 0}, FOUR_PI}},
  {"pendulum", {pendulum, {2, 0}, 60}},
  {"henon_heiles_6pi", {henon_heiles, {0.3, -0.3, 0.3, 0.15}, SIX_PI}},
  {"henon_heiles_100", {henon_heiles, {0.3, -0.3, 0.3, 0.15}, 100}},
  {"henon_heiles_300", {henon_heiles, {0.3, -0.3, 0.3, 0.15}, 300}},
  {"kepler", {kepler, {0.4, 0, 0, 2}, FOUR_PI}},
  {"pleiades",
   {pleiades,
    {3, 3, -1, -3, 2, -2, 2,       // x
     3, -3, 2, 0, 0, -4, 4,        // y
     0, 0, 0, 0, 0, 1.75, -1.5,    // velocities
     0, 0, 0, -1.25, 1, 0, 0},
    3}},
  {"henon_heiles_chaos", {henon_heiles, {0, -0.15, 0.5555, 0}, 2000, true}},
};

const int ORDERS[] = {20, 30};
const double TOLERANCES[] = {0, 1e-16, 1e-14, 1e-12};  // of a step; 0: CAPD's default
const int REPEATS = 5;                                 // timed runs, of which the best counts
const double ONCE = 2e3;                               // milliseconds; a longer run is not repeated
const double LIMIT = 60e3;                             // milliseconds after which a run ends
const double LOST = 10;                                // width at which a run ends
const double WIDTH = 1e-9;                             // that the fastest run has to keep
const double REACHES[] = {1e-6, 1};                    // widths whose last times are sought
const double NEVER = std::numeric_limits<double>::infinity();

struct Row {
  std::string set;
  int order;
  double tolerance;
  double milliseconds = NEVER;
  double width = NEVER;       // largest of a component
  double derivative = NEVER;  // largest width of an entry of the derivative by the start
  double reach[2] = {0, 0};   // last step's end with a width below REACHES
  std::string refusal;        // why the end was not reached
  std::vector<double> lower, upper;
};

double cpu()
{
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return 1e3 * now.tv_sec + 1e-6 * now.tv_nsec;
}

template <class Enclosure>
double widest(const Enclosure &enclosure)
{
  return capd::vectalg::maxDiam(enclosure).rightBound();
}

// CAPD leaves the rounding mode as its last operation set it; printing needs the usual one.
std::string number(double value)
{
  fesetround(FE_TONEAREST);
  if (!std::isfinite(value)) return "null";
  char text[40];
  snprintf(text, sizeof text, "%.17g", value);
  return text;
}

std::string numbers(const std::vector<double> &values)
{
  std::string text;
  for (double value : values) text += (text.empty() ? "" : ", ") + number(value);
  return "[" + text + "]";
}

template <class Set>
Row run(const Problem &problem, const std::string &name, int order, double tolerance)
{
  Row row{name, order, tolerance};
  const int n = problem.start.size();
  capd::IMap field(problem.field, n, n, 0);
  capd::IOdeSolver solver(field, order);
  if (tolerance > 0) {
    solver.setAbsoluteTolerance(tolerance);
    solver.setRelativeTolerance(tolerance);
  }
  else
    row.tolerance = solver.getAbsoluteTolerance();
  capd::ITimeMap flow(solver);
  IVector start(n);
  for (int i = 0; i < n; ++i) start[i] = problem.start[i];
  // The first run watches the width after each step, and the time; those that are timed only march.
  try {
    const double begun = cpu();
    Set set(start);
    flow.stopAfterStep(true);
    do {
      const double width = widest(flow(problem.end, set));
      row.milliseconds = cpu() - begun;
      for (int k = 0; k < 2; ++k)
        if (width < REACHES[k]) row.reach[k] = flow.getCurrentTime().leftBound();
      if (!(width < LOST)) throw std::runtime_error("the width passes " + number(LOST));
      if (!(row.milliseconds < LIMIT)) throw std::runtime_error("the time passes the limit");
    } while (!flow.completed());
    const IVector end(set);
    row.width = widest(end);
    for (int i = 0; i < n; ++i) {
      row.lower.push_back(end[i].leftBound());
      row.upper.push_back(end[i].rightBound());
    }
    if constexpr (std::is_convertible_v<Set, IMatrix>) row.derivative = widest(IMatrix(set));
    flow.stopAfterStep(false);
    if (problem.reach || row.milliseconds > ONCE) return row;
    row.milliseconds = NEVER;
    for (int k = 0; k < REPEATS; ++k) {
      const double begun = cpu();
      Set set(start);
      flow(problem.end, set);
      row.milliseconds = std::min(row.milliseconds, cpu() - begun);
    }
  }
  catch (const std::exception &refused) {
    row.refusal = std::string(refused.what()).substr(0, 80);
    std::replace_if(row.refusal.begin(), row.refusal.end(),
                    [](char c) { return c < ' ' || c == '"' || c == '\\'; }, ' ');
  }
  return row;
}

template <class Set>
void add(std::vector<Row> &rows, const Problem &problem, const char *name)
{
  for (int order : ORDERS)
    for (double tolerance : TOLERANCES) rows.push_back(run<Set>(problem, name, order, tolerance));
}

std::string json(const Row &row, bool reach, bool state)
{
  std::string text = "{\"set\": \"" + row.set + "\", \"order\": " + std::to_string(row.order) +
                     ", \"tolerance\": " + number(row.tolerance) +
                     ", \"ms\": " + number(row.milliseconds);
  if (reach)
    text += ", \"t_1e-6\": " + number(row.reach[0]) + ", \"t_1\": " + number(row.reach[1]);
  else
    text += ", \"width\": " + number(row.width) +
            ", \"derivative_width\": " + number(row.derivative);
  if (!row.refusal.empty()) text += ", \"refusal\": \"" + row.refusal + "\"";
  if (state) text += ", \"lower\": " + numbers(row.lower) + ", \"upper\": " + numbers(row.upper);
  return text + "}";
}

// The row with the least value among those that `allowed` admits, as JSON; null if there is none.
template <class Value, class Allowed>
std::string least(const std::vector<Row> &rows, bool reach, bool state, Value value,
                  Allowed allowed)
{
  const Row *best = nullptr;
  for (const Row &row : rows)
    if (allowed(row) && (!best || value(row) < value(*best))) best = &row;
  return best ? json(*best, reach, state) : "null";
}

std::string section(const std::vector<Row> &rows, bool reach)
{
  const auto arrived = [](const Row &row) { return row.width < NEVER; };
  const auto first_order = [](const Row &row) { return row.derivative < NEVER; };
  std::string text;
  if (reach)
    for (int k = 0; k < 2; ++k)
      text += std::string(k ? ", " : "") + "\"longest_" + (k ? "1" : "1e-6") + "\": " +
              least(rows, reach, false, [k](const Row &row) { return -row.reach[k]; },
                    [](const Row &) { return true; });
  else {
    text = "\"fastest\": " + least(rows, reach, false,
                                   [](const Row &row) { return row.milliseconds; },
                                   [](const Row &row) { return row.width <= WIDTH; });
    text += ", \"narrowest\": " +
            least(rows, reach, true, [](const Row &row) { return row.width; }, arrived);
    if (std::any_of(rows.begin(), rows.end(), first_order))
      text += ", \"narrowest_derivative\": " +
              least(rows, reach, false, [](const Row &row) { return row.derivative; },
                    first_order);
  }
  std::string all;
  for (const Row &row : rows) all += (all.empty() ? "" : ", ") + json(row, reach, false);
  return "{" + text + ", \"rows\": [" + all + "]}";
}

int main(int count, char **words)
{
  const auto found = count == 2 ? PROBLEMS.find(words[1]) : PROBLEMS.end();
  if (found == PROBLEMS.end()) {
    fprintf(stderr, "usage: capd NAME, with NAME one of");
    for (const auto &problem : PROBLEMS) fprintf(stderr, " %s", problem.first.c_str());
    fprintf(stderr, "\n");
    return 2;
  }
  const Problem &problem = found->second;
  std::vector<Row> state, first;
  add<capd::C0Rect2Set>(state, problem, "C0Rect2Set");
  add<capd::C0TripletonSet>(state, problem, "C0TripletonSet");
  add<capd::C0HORect2Set>(state, problem, "C0HORect2Set");
  add<capd::C0HOTripletonSet>(state, problem, "C0HOTripletonSet");
  add<capd::C1Rect2Set>(first, problem, "C1Rect2Set");
  add<capd::C1HORect2Set>(first, problem, "C1HORect2Set");
  printf("{\"problem\": \"%s\", \"t\": %s, \"c0\": %s, \"c1\": %s}\n", words[1],
         number(problem.end).c_str(), section(state, problem.reach).c_str(),
         section(first, problem.reach).c_str());
}
