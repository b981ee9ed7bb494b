"""Options of the charts, for ECharts in the browser, which draws them as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hamsym.plotting.style import COLORS
from hamsym.workbench.explore.results import Picture, SectionPicture

_FAINT = "#c8ccd2"
_INK = "#1f2328"
_SOFT = "#5f6368"
_FAILED = "#b3261e"
_LEAST_ERROR = 1e-18  # zero has no place on a logarithmic axis


def _pairs(x: np.ndarray, y: np.ndarray) -> list[list[float | None]]:
    """Return points with six digits, which are more than a screen shows; gaps where not finite.

    Examples
    --------
    >>> _pairs(np.array([1 / 3, 2.0]), np.array([np.nan, 1.0]))
    [[None, None], [2.0, 1.0]]
    """
    points = np.stack([x, y], axis=-1).astype(float)
    with np.errstate(all="ignore"):
        unit = 10.0 ** (5 - np.floor(np.log10(np.abs(points))))
        rounded = np.round(points * unit) / unit
    # Zeros, and numbers next to the smallest ones, have no such unit.
    points = np.where(np.isfinite(rounded), rounded, points)
    found: list[list[float | None]] = points.tolist()
    for row in np.flatnonzero(~np.isfinite(points).all(axis=-1)):
        found[row] = [None, None]
    return found


def _unit(values: np.ndarray) -> float:
    """Return the power of ten in which values are drawn: ECharts rounds to twenty decimals.

    Examples
    --------
    >>> _unit(np.array([0.0, 3.2e-24])), _unit(np.array([0.01, 250.0]))
    (1e-24, 1.0)
    """
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    if largest == 0 or 1e-3 <= largest < 1e5:
        return 1.0
    return float(f"1e{3 * int(np.floor(np.log10(largest) / 3))}")


def _in_unit(name: str, unit: float) -> str:
    return name if unit == 1 else f"{name} / {unit:.0e}".replace("e-0", "e-").replace("e+0", "e")


def _axis(name: str, **options: Any) -> dict[str, Any]:
    return {
        "type": "value",
        "name": name,
        "nameLocation": "middle",
        "nameGap": 26,
        "scale": True,
        "min": None,  # options are merged: what is left out would stay
        "max": None,
        "splitLine": {"lineStyle": {"color": "#eceef1"}},
        "axisLabel": {"hideOverlap": True},
        "axisLine": {"onZero": False, "show": True},
        **options,
    }


def _ends(values: np.ndarray) -> dict[str, float]:
    """Return ends for an axis of nearly constant values, which would show round-off."""
    known = values[np.isfinite(values)]
    if not known.size:
        return {}
    low, high = float(known.min()), float(known.max())
    largest = max(abs(low), abs(high))
    if high - low > 1e-6 * largest:
        return {}
    return {"min": low - 0.1 * (largest or 1.0), "max": high + 0.1 * (largest or 1.0)}


def _time_axis(t: np.ndarray, unit: float) -> dict[str, Any]:
    low, high = sorted((float(t[0]), float(t[-1])))
    label = {"hideOverlap": True, "showMinLabel": True, "showMaxLabel": False}
    return _axis(_in_unit("t", unit), min=low, max=high, axisLabel=label)


def _chart(title: str, x: dict[str, Any], y: dict[str, Any], series: list[Any]) -> dict[str, Any]:
    y = {"nameGap": 46, **{key: value for key, value in y.items() if key != "nameGap"}}
    return {
        "animation": False,
        "color": list(COLORS),
        "title": {"text": title, "left": 8, "top": 4, "textStyle": {"fontSize": 14, "color": _INK}},
        "legend": {
            "type": "scroll",
            "top": 26,
            "left": 8,
            "right": 8,
            "icon": "rect",
            "itemHeight": 3,
        },
        "grid": {"left": 66, "right": 18, "top": 56, "bottom": 44},
        "tooltip": {"trigger": "item"},
        "aria": {"enabled": True, "label": {"description": title}},
        "xAxis": x,
        "yAxis": y,
        "series": series,
    }


def _line(name: str, data: list[Any], color: str, **options: Any) -> dict[str, Any]:
    return {
        "type": "line",
        "name": name,
        "data": data,
        "showSymbol": False,
        "color": color,
        "lineStyle": {"width": 1.8},
        "emphasis": {"disabled": True},
        **options,
    }


def empty(title: str) -> dict[str, Any]:
    """Return a chart without curves."""
    return _chart(title, _axis(""), _axis(""), [])


def _title(text: str, picture: Picture) -> str:
    return text if picture.success else f"{text} (not accepted)"


def over_time(title: str, names: Sequence[str], index: Sequence[int], picture: Picture) -> Any:
    """Return components over time."""
    values = picture.z[:, list(index)]
    unit, time = _unit(values), _unit(picture.t)
    series = [
        _line(names[i], _pairs(picture.t / time, values[:, k] / unit), COLORS[k % len(COLORS)])
        for k, i in enumerate(index)
    ]
    title, y = _title(_in_unit(title, unit), picture), _axis("", **_ends(values / unit))
    return _marked(_chart(title, _time_axis(picture.t / time, time), y, series), picture)


def errors_over_time(picture: Picture, tol: float, forced: bool) -> Any:
    """Return the energy error and the estimated error over time, on a logarithmic axis."""
    energy = "energy error beyond work" if forced else "energy error"
    curves = [(energy, picture.energy_error), ("estimated error", picture.error)]
    time = _unit(picture.t)
    t = picture.t / time
    series = [
        _line(name, _pairs(t, np.maximum(values, _LEAST_ERROR)), COLORS[k])
        for k, (name, values) in enumerate(curves)
    ]
    style = {"type": "dashed", "width": 1.4}
    series.append(_line("tolerance", _pairs(t[[0, -1]], np.full(2, tol)), _SOFT, lineStyle=style))
    y = _axis("", type="log", min=_decade_below(picture, tol))
    title = _title("Energy error and estimated error", picture)
    return _marked(_chart(title, _time_axis(t, time), y, series), picture)


def _decade_below(picture: Picture, tol: float) -> float:
    """Return the foot of the axis: zeros at the start would stretch it to 1e-18."""
    values = np.concatenate([picture.energy_error, picture.error, [tol]])
    values = values[np.isfinite(values) & (values > 0)]
    low = float(np.quantile(values, 0.05))
    return float(10.0 ** np.floor(np.log10(max(min(low, tol), _LEAST_ERROR))))


def plane(names: Sequence[str], x: int, y: int, picture: Picture) -> Any:
    """Return the orbit in the plane of two components, with level sets if there are any."""
    series: list[Any] = []
    units = _unit(picture.z[:, x]), _unit(picture.z[:, y])
    axes = [
        _axis(_in_unit(names[k], unit), **_ends(picture.z[:, k] / unit))
        for k, unit in zip((x, y), units, strict=True)
    ]
    if picture.box is not None and (x, y) == (0, 1):
        gap = np.full((1, 2), np.nan)
        levels = np.concatenate([part for line in picture.levels for part in (line, gap)] or [gap])
        series.append(
            _line(
                "level sets of H",
                _pairs(levels[:, 0] / units[0], levels[:, 1] / units[1]),
                _FAINT,
                lineStyle={"width": 1.0},
                silent=True,
            )
        )
        ends = np.reshape(picture.box, (2, 2))
        for axis, unit, (low, high) in zip(axes, units, ends, strict=True):
            label = {"showMinLabel": False, "showMaxLabel": False}
            axis.update(min=low / unit, max=high / unit, axisLabel=label)
    orbit = _pairs(picture.z[:, x] / units[0], picture.z[:, y] / units[1])
    series.append(_line("orbit", orbit, COLORS[0]))
    start = {"type": "scatter", "name": "start", "data": orbit[:1], "symbolSize": 9}
    series.append({**start, "color": COLORS[1]})
    dof = len(names) // 2
    kind = "Phase portrait" if y == x + dof else "Orbit"
    title = _title(f"{kind}: {names[x]}, {names[y]}", picture)
    chart = _chart(title, axes[0], axes[1], series)
    varies = all(axis["min"] is None for axis in axes)
    if x < dof and y < dof and units[0] == units[1] and varies:  # in space, with one scale
        chart["equal"] = [
            [float(values.min()) / units[0], float(values.max()) / units[0]]
            for values in (picture.z[:, x], picture.z[:, y])
        ]
    return _marked(chart, picture)


def section_plane(found: SectionPicture, surface: str) -> Any:
    """Return the crossings of a surface."""
    units = _unit(found.points[:, 0]), _unit(found.points[:, 1])
    x, y = (
        _axis(_in_unit(name, unit), **_ends(values / unit))
        for name, unit, values in zip(found.axes, units, found.points.T, strict=True)
    )
    points = {
        "type": "scatter",
        "name": f"{len(found.points):,} crossings",
        "data": _pairs(found.points[:, 0] / units[0], found.points[:, 1] / units[1]),
        "symbolSize": 3,
        "color": COLORS[0],
        "silent": True,
    }
    return _chart(f"Section at {surface}", x, y, [points])


def _marked(chart: dict[str, Any], picture: Picture) -> dict[str, Any]:
    """Return the chart with a title in red if the solution was not accepted."""
    if not picture.success:
        chart["title"]["textStyle"]["color"] = _FAILED
    return chart
