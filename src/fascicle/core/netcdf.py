"""NetCDF-4 files that others may have changed, as datasets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fascicle.core.errors import InputError, one_line
from fascicle.core.isolated import read_isolated

if TYPE_CHECKING:
    import xarray as xr

# What the libraries raise on damaged files
DAMAGED: tuple[type[Exception], ...] = (
    OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError, ArithmeticError,
    AssertionError, NameError, EOFError,
)  # fmt: skip


def load_netcdf(path: Path, group: str = "/") -> xr.Dataset:
    """Load one group of a file, in a child process: HDF5 may crash or never end.

    Variables are as stored: fill values are not replaced, times are not decoded. Raises InputError
    if the file cannot be read, or has no such group.
    """
    import xarray as xr

    parts = read_isolated(read_group, path, group=group)
    variables = {name: (dims, values, attrs) for name, dims, values, attrs in parts["variables"]}
    try:
        return xr.Dataset(variables, attrs=parts["attributes"])
    except ValueError as error:  # sizes that contradict one another
        raise InputError(f"{path}: damaged ({one_line(error)})") from None


def read_group(path: Path, group: str) -> dict[str, Any]:
    """Attributes and variables of a group, as plain data."""
    import h5netcdf

    try:
        with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
            h5_group = file if group == "/" else file[group]
            variables = [
                (name, variable.dimensions, _plain(variable[...]), _attributes(variable))
                for name, variable in h5_group.variables.items()
            ]
            return {"variables": variables, "attributes": _attributes(h5_group)}
    except (*DAMAGED, h5netcdf.CompatibilityError) as error:
        raise InputError(f"{path}: not a readable netCDF file ({one_line(error)})") from None


def _attributes(item: Any) -> dict[str, Any]:
    return {str(name): _plain(value) for name, value in item.attrs.items()}


def _plain(value: Any) -> Any:
    """Value without Python objects: texts become arrays of fixed width."""
    if isinstance(value, np.ndarray) and value.dtype.hasobject:
        return value.astype(str)
    return value
