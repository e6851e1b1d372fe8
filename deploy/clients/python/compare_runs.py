"""Figures of several runs beside each other. Needs no package.

Usage: compare_runs.py RUN [RUN ...]
RUN is a run directory of `coxswain launch`, with its summary.json.
"""
import json
import pathlib
import sys

FIGURES = ["position_rmse_m", "position_max_m", "heading_rmse_rad", "tick_p50_us", "periods_missed"]


def summary(run: str) -> dict:
    """The figures of one run."""
    try:
        return json.loads((pathlib.Path(run) / "summary.json").read_text())
    except (OSError, ValueError) as error:
        sys.exit(f"{run}: expected a run directory with summary.json: {error}")


def main() -> None:
    runs = sys.argv[1:]
    if not runs:
        print(__doc__, file=sys.stderr)
        sys.exit(2)
    summaries = [summary(run) for run in runs]
    names = [pathlib.Path(run).name for run in runs]
    print(f"{'figure':20}" + "".join(f"{name[-24:]:>26}" for name in names))
    for figure in FIGURES:
        values = [found.get(figure) for found in summaries]
        cells = ("-" if value is None else f"{value:.6g}" for value in values)
        print(f"{figure:20}" + "".join(f"{cell:>26}" for cell in cells))


if __name__ == "__main__":
    main()
