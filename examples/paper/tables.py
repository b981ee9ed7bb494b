"""Numbers with their spread over the seeds, and tables of these."""

import math

from hamsym.support.atomic import write_atomically


def spread(values):
    """Median (the lower one for an even count), minimum and maximum."""
    ordered = sorted(float(value) for value in values)
    return [ordered[(len(ordered) - 1) // 2], ordered[0], ordered[-1]]


def lower(one, other):
    """Whether one spread is below another; a text if the two overlap."""
    if one[2] < other[1]:
        return True
    if one[1] > other[2]:
        return False
    return f"undecided: the seeds overlap, the median is {'lower' if one < other else 'not lower'}"


def finite(value):
    """Replace nan by None and infinity by "inf" for JSON."""
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf"
    return value


def short(value):
    """Format a number with two digits, or a median with its range in parentheses."""
    if value is None:
        return ""
    if isinstance(value, list):
        middle, least, most = value
        if least == most:
            return short(middle)
        return f"{short(middle)} ({short(least)} to {short(most)})"
    if value == "inf" or math.isinf(value):
        return "infinite"
    return "" if math.isnan(value) else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e")


def seconds(value):
    """Format the median of CPU or wall seconds."""
    return "" if value is None else f"{value[0]:,.0f}" if value[0] >= 10 else f"{value[0]:.2g}"


def markdown_table(rows):
    """Format the table of an experiment as Markdown."""
    heads = (
        "method",
        "points",
        "evaluations",
        "error",
        "energy error",
        "proven bound",
        "CPU s",
        "wall s",
    )
    lines = [f"| {' | '.join(heads)} |", "| --- " + "| ---: " * (len(heads) - 1) + "|"]
    for row in rows:
        cells = (
            row["method"],
            f"{row['points']:,}",
            f"{row['evaluations'][0]:,.0f}",
            short(row["error"]),
            short(row["energy error"]),
            short(row.get("proven bound")) or ("refused" if row.get("refused") else ""),
            seconds(row["CPU seconds"]),
            seconds(row["seconds"]),
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def console_table(rows):
    """Format the table for a terminal of 80 columns, medians only."""
    heads = ("error", "energy", "proven", "CPU s")
    lines = [f"{'method':<40}" + "".join(f"{head:>10}" for head in heads)]
    for row in rows:
        proven = row.get("proven bound")
        cells = (
            short(row["error"][0]),
            short(row["energy error"][0]),
            short(proven[0]) if proven else "",
            seconds(row["CPU seconds"]),
        )
        lines.append(f"{row['method']:<40}" + "".join(f"{cell:>10}" for cell in cells))
    return "\n".join(lines)


def write(path, text):
    """Write a file atomically: readers see the old or the new content."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode())
