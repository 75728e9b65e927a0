"""The plots of Figures 7 and 8, their tables, and what can be said of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, BinaryIO

from hpcapp.lab.reproduce.finding import Finding
from hpcapp.lab.reproduce.readings import STEP_1
from hpcapp.lab.reproduce.scaling import (
    WAYS,
    ScalingRun,
    Spread,
    Summary,
    limit_of_fits,
    summarise,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: The paper's speed-up in its own words, by the number of its slaves.
_PAPER_SPEEDUP = {4: "almost double"}
_NO_NUMBERS = (
    "The paper's cloud for this figure is not published and its machines were others, so its "
    "times cannot be met"
)

_STEP_1 = (
    f"{STEP_1}; it is the master's, so that it would add to every job the same and lower every "
    "speed-up."
)


def make_figure_7(runs: Sequence[ScalingRun], subject: str, cores: int, file: BinaryIO) -> Finding:
    """Draw the time of runs of all ways, from 0 workers, against the number of workers, as a PNG.

    The subject says what was reconstructed, at which grid; workers and master share the cores.
    """
    ways = _by_way(runs)
    figure, axes = _open_axes(ways, cores)
    for way, lines in ways.items():
        _draw(axes, lines, [line.job_s for line in lines], f"whole job, {way} handed out", "o")
    fits = ways["fits"]
    _draw(axes, fits, [line.fit_s for line in fits], "the paper's fits alone", "s")
    axes.set(yscale="log", ylabel="time, s", title="Time (the paper's Figure 7)")
    _save(figure, axes, file)
    rows = [
        (
            _name(fit),
            fit.start_s.cell() if fit.workers else "-",
            fit.first_fit_s.cell(1e3, 0),
            fit.fit_s.cell(1e3, 0),
            fit.job_s.cell(),
            tile.job_s.cell(),
            f"{fit.bytes_sent / 1e6:.1f}",
            f"{tile.bytes_sent / 1e6:.1f}",
            _PAPER_SPEEDUP.get(fit.workers, "-"),
        )
        for fit, tile in zip(fits, ways["tiles"], strict=True)
    ]
    return Finding(
        f"Figure 7: time by workers, {subject}",
        ("workers", "start, s", "the paper's fits at first, ms", "the paper's fits, ms",
         "job with fits handed out, s", "job with tiles handed out, s",
         "MB sent with fits", "MB sent with tiles", "speed-up in the paper"),
        tuple(rows),
        f"{_NO_NUMBERS}: {_share(fits):.1f} % of the paper's method is in its fits here, and "
        f"{_compare_cores(cores, fits[-1].workers)} {_STEP_1}",
        "Time by the number of workers: medians, with bars from the fastest to the slowest run.",
    )  # fmt: skip


def make_figure_8(runs: Sequence[ScalingRun], subject: str, cores: int, file: BinaryIO) -> Finding:
    """Draw speed-up against the number of workers; see `make_figure_7`."""
    ways = _by_way(runs)
    figure, axes = _open_axes(ways, cores)
    for way, lines in ways.items():
        speedups = [line.job_speedup for line in lines]
        _draw(axes, lines, speedups, f"whole job, {way} handed out", "o")
    fits = ways["fits"]
    limits = [limit_of_fits(_share(fits) / 100.0, line.workers) for line in fits]
    workers = [line.workers for line in fits]
    axes.plot(workers, limits, "--", color="grey", label="fits, if handing them out were free")
    axes.plot(workers, [max(1, count) for count in workers], ":", color="grey", label="ideal")
    if (slaves := max(_PAPER_SPEEDUP)) in workers:
        words = f"the paper: {_PAPER_SPEEDUP[slaves]}"
        axes.plot([slaves], [2.0], "v", color="black", fillstyle="none", label=words)
    axes.set(ylim=(0, None), ylabel="speed-up over the master alone")
    axes.set_title("Speed-up (the paper's Figure 8)")
    _save(figure, axes, file)
    rows = [
        (_name(fit), fit.fit_speedup.cell(), fit.job_speedup.cell(), f"{limit:.2f}",
         tile.job_speedup.cell(), _PAPER_SPEEDUP.get(fit.workers, "-"))
        for fit, tile, limit in zip(fits, ways["tiles"], limits, strict=True)
    ]  # fmt: skip
    return Finding(
        f"Figure 8: speed-up by workers, {subject}",
        ("workers", "the paper's fits", "job with fits handed out", "if that were free",
         "job with tiles handed out", "in the paper"),
        tuple(rows),
        "The paper's speed-up is not met by handing out fits: they are "
        f"{_share(fits):.1f} % of the job here, so Amdahl's law leaves "
        f"{limits[-1]:.2f} with {_count(workers[-1], 'worker')}; "
        f"{_compare_cores(cores, workers[-1])} {_STEP_1}",
        "Speed-up by the number of workers: medians, with bars from the least to the most of "
        "any round.",
    )  # fmt: skip


def _by_way(runs: Sequence[ScalingRun]) -> dict[str, list[Summary]]:
    return {way: summarise([run for run in runs if run.way == way]) for way in WAYS}


def _share(fits: list[Summary]) -> float:
    """Return the fits' share of the job without workers, by the medians, in per cent."""
    return 100.0 * fits[0].fit_s.median / fits[0].job_s.median


def _compare_cores(cores: int, workers: int) -> str:
    if cores > workers:
        return f"{_count(workers, 'worker')} and the master have {cores} cores for themselves."
    return (
        f"{_count(workers, 'emulated machine')} and the master share {_count(cores, 'core')}, so "
        f"that no way of handing out can gain more than {_count(cores, 'time')}."
    )


def _count(number: int, noun: str) -> str:
    """Return a number and its noun.

    Examples
    --------
    >>> _count(1, "core"), _count(2, "core")
    ('1 core', '2 cores')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _name(line: Summary) -> str:
    return "0 (the master alone)" if line.workers == 0 else str(line.workers)


def _open_axes(ways: dict[str, list[Summary]], cores: int) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure  # optional and heavy

    figure = Figure(figsize=(6.4, 4.8), dpi=120, layout="constrained")
    axes = figure.subplots()
    axes.set(
        xticks=[line.workers for line in ways["fits"]],
        xlabel=f"workers (0: the master alone; {_count(cores, 'core')} in all)",
    )
    axes.grid(visible=True, alpha=0.3)
    return figure, axes


def _draw(axes: Axes, lines: list[Summary], values: list[Spread], label: str, marker: str) -> None:
    """Draw medians, with bars from the smallest to the largest value."""
    middle = [value.median for value in values]
    bars = (
        [value.median - value.low for value in values],
        [value.high - value.median for value in values],
    )
    workers = [line.workers for line in lines]
    axes.errorbar(workers, middle, yerr=bars, marker=marker, capsize=3, label=label)


def _save(figure: Figure, axes: Axes, file: BinaryIO) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
    figure.savefig(file, format="png")
