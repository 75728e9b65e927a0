"""The price table that ships: what a machine on Amazon EC2 costs an hour, on demand."""

from __future__ import annotations

import re
from collections.abc import Iterator
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from typing import Literal

from hpccomponent.config.reader import ConfigModel, parse_config

_HOURS_A_MONTH = 730.0
_DISK_GB = 8  # of an image that says nothing else
_SMALL_SIZES = {"nano": 1 / 16, "micro": 1 / 8, "small": 1 / 4, "medium": 1 / 2, "large": 1.0}
_USUAL_SIZES = (*_SMALL_SIZES, "xlarge", *(f"{number}xlarge" for number in (2, 4, 8, 12, 16, 24)))


class PriceTable(ConfigModel):
    """List prices, in dollars.

    Parameters
    ----------
    version : 1
        Of the file's format.
    as_of : str
        Year and month of the prices.
    large : dict of str to float
        An hour of the size ``large`` of each family, in us-east-1.
    regions : dict of str to float
        How many times dearer each region is, at most.
    public_address : float
        An hour of one public address.
    disk_gb_month : float
        A month of one GB of disk.
    """

    version: Literal[1]
    as_of: str
    large: dict[str, float]
    regions: dict[str, float]
    public_address: float
    disk_gb_month: float

    def hourly(self, instance_type: str, region: str, disk_gb: int | None = None) -> float | None:
        """Return what a machine costs an hour with its disk and address; None if not known.

        Parameters
        ----------
        disk_gb : int, optional
            Of the root disk, 10^9 bytes; by default what an image has that says nothing else.

        Returns
        -------
        float or None
            In dollars.

        Examples
        --------
        >>> round(read_prices().hourly("m6i.2xlarge", "us-east-1", disk_gb=20), 4)
        0.3912
        >>> read_prices().hourly("x9.large", "us-east-1") is None
        True
        """
        family, _, size = instance_type.partition(".")
        factor = self.regions.get(region)
        share = _size(size)
        if family not in self.large or factor is None or share is None:
            return None
        disk = (_DISK_GB if disk_gb is None else disk_gb) * self.disk_gb_month / _HOURS_A_MONTH
        return (self.large[family] * share + disk) * factor + self.public_address

    def doubt(self, instance_type: str, region: str) -> Iterator[tuple[str, str]]:
        """Yield what the list does not know of a machine: its key, and what is said of it.

        Examples
        --------
        >>> dict(read_prices().doubt("m6i.2xlrage", "us-east-1"))
        {'instance_type': 'm6i.2xlrage is not in the price list of 2025-06; m6i.2xlarge is'}
        """
        family, _, size = instance_type.partition(".")
        told = f"is not in the price list of {self.as_of}"
        if family not in self.large or _size(size) is None:
            known = [f"{one}.{other}" for one in self.large for other in _USUAL_SIZES]
            yield "instance_type", f"{instance_type} {told}{_say_near(instance_type, known)}"
        if region not in self.regions:
            yield "region", f"{region} {told}{_say_near(region, list(self.regions))}"


def _say_near(wrong: str, known: list[str]) -> str:
    """Say which name is near; nothing where none is."""
    nearest = get_close_matches(wrong, known, n=1)
    return f"; {nearest[0]} is" if nearest else ""


def _size(size: str) -> float | None:
    """Return a size as a multiple of ``large``: ``4xlarge`` is 8 times as much."""
    if size in _SMALL_SIZES:
        return _SMALL_SIZES[size]
    match = re.fullmatch(r"(\d*)xlarge", size)
    return 2.0 * int(match[1] or 1) if match else None


@cache
def read_prices() -> PriceTable:
    """Read the table that ships with this release."""
    text = files("hpcdeploy.spec").joinpath("prices.yaml").read_text(encoding="utf-8")
    return parse_config(text, "prices.yaml", PriceTable)
