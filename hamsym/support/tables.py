"""Tables and labelled arrays of results, for pandas and xarray, which are optional packages."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hamsym.errors import InputError


def optional_package(name: str, purpose: str, wanted: str = "") -> Any:
    """Import a package that only some users need; ``wanted`` is what pip is told, if not its name.

    Raise InputError if it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(
            f"{purpose} needs the package {name}, which is not installed; install it with "
            f"pip install {wanted or name}"
        ) from None


def member_axes(shape: Sequence[int]) -> list[str]:
    """Names of the axes of an ensemble: ``member``, or ``axis_0``, ``axis_1``, ... of several.

    Examples
    --------
    >>> member_axes((3,)), member_axes((3, 4)), member_axes(())
    (['member'], ['axis_0', 'axis_1'], [])
    """
    return ["member"] if len(shape) == 1 else [f"axis_{i}" for i in range(len(shape))]


def time_name(names: Sequence[str]) -> str:
    """Name of the column of times: ``t``, or ``time`` if a component is called t."""
    return "time" if "t" in names else "t"


def data_frame(
    columns: Mapping[str, np.ndarray],
    index: Mapping[str, np.ndarray] | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> Any:
    """Make a ``pandas.DataFrame`` of columns of one length.

    Raise InputError if pandas is not installed.

    - index: Levels of the index.
    - attributes: Of its ``attrs``.
    """
    pandas = optional_package("pandas", "to_dataframe")
    levels = dict(index or {})
    made = None
    if len(levels) == 1:
        ((name, values),) = levels.items()
        made = pandas.Index(values, name=name)
    elif levels:
        made = pandas.MultiIndex.from_arrays(list(levels.values()), names=list(levels))
    frame = pandas.DataFrame(dict(columns), index=made)
    frame.attrs.update(attributes or {})
    return frame


def ensemble_frame(
    shape: Sequence[int],
    time: Mapping[str, np.ndarray],
    columns: Mapping[str, np.ndarray],
    parameters: Mapping[str, np.ndarray],
    attributes: Mapping[str, Any],
) -> Any:
    """Make a ``pandas.DataFrame`` of an ensemble, with a row for each member and time.

    Raise InputError if pandas is not installed.

    - shape: Of the ensemble.
    - time: Name and values of the times, shape (n,).
    - columns: Shapes (*shape, n).
    - parameters: Values of each member, as many as there are members.
    """
    ((name, times),) = time.items()
    places = np.indices((*shape, len(times))).reshape(len(shape) + 1, -1)
    index = dict(zip(member_axes(shape), places[:-1], strict=True)) | {name: times[places[-1]]}
    flat = {key: values.ravel() for key, values in columns.items()}
    flat |= {key: np.repeat(values.ravel(), len(times)) for key, values in parameters.items()}
    return data_frame(flat, index, attributes)


def data_set(
    variables: Mapping[str, Any], coordinates: Mapping[str, Any], attributes: Mapping[str, Any]
) -> Any:
    """Make an ``xarray.Dataset``.

    Raise InputError if xarray is not installed.
    """
    xarray = optional_package("xarray", "to_xarray")
    return xarray.Dataset(dict(variables), coords=dict(coordinates), attrs=dict(attributes))
