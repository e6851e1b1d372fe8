"""Repeats all measurements of docs/results.md. Writes docs/results.csv, a line per cell with
every seed, and the tables of docs/results.md between their marks.

Needs python3 and: cargo build --release --workspace --bins
Usage: python3 docs/results.py [NUMBER ...]   the sets with these numbers; all without any
       python3 docs/results.py tables         nothing is run: docs/results.csv is read
"""
import csv
import json
import math
import pathlib
import re
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).parent
CSV, PAGE = HERE / "results.csv", HERE / "results.md"
COXSWAIN = HERE.parent / "target/release/coxswain"

# The weights were tuned on the first three scenarios. The others are held out.
TUNED, HELD_OUT = ["figure-eight", "square", "stop-and-go"], ["slalom", "ring", "shuttle"]
OURS, ORACLE = "gpr-mpc+observer", "oracle-mpc"
OBSERVERS = ["mpc+observer", "mpc+kalman"]
LEAST_SQUARES = ["rls-mpc+observer", "physics-mpc+observer"]
SIMPLE = ["feedforward-p", "mpc"] + OBSERVERS + LEAST_SQUARES
ALL = SIMPLE + ["gpr-mpc", OURS, ORACLE]
# A warm run of these starts with the model of an earlier run.
REMEMBER = LEAST_SQUARES + ["gpr-mpc", OURS]
BOTH = ["cold", "warm"]

# Table, scenarios, profile, sensors, controllers, starts, seeds.
SETS = [
    ("held-out-100", HELD_OUT, "paper", "noisy", ALL, BOTH, 10),
    ("held-out-100", HELD_OUT, "paper", "noisy", [OURS], ["stale"], 3),
    ("held-out-20", HELD_OUT, "agile", "noisy", SIMPLE + [OURS], BOTH, 5),
    ("held-out-20", HELD_OUT, "agile", "noisy", [OURS], ["stale"], 3),
    ("held-out-20", HELD_OUT, "agile", "noisy", [ORACLE], ["cold"], 1),
    ("tuned-100", TUNED, "paper", "noisy", SIMPLE + [OURS, ORACLE], BOTH, 3),
    ("tuned-20", TUNED, "agile", "noisy", SIMPLE + [OURS], BOTH, 3),
    ("exact-100", HELD_OUT, "paper", "exact", SIMPLE + [OURS, ORACLE], ["cold"], 3),
    ("exact-20", HELD_OUT, "agile", "exact", SIMPLE + [OURS], ["cold"], 3),
]
FIELDS = ["table", "profile", "sensors", "scenario", "controller", "start", "rmse_mm_of_each_seed",
          "recovery_s_of_each_seed", "coverage_of_each_axis", "half_width_of_each_axis",
          "residual_rms_of_each_axis"]


def measured(table, scenarios, profile, sensors, controllers, starts, seeds):
    """The cells of one set, as rows of the CSV."""
    with tempfile.TemporaryDirectory() as folder:
        rows = pathlib.Path(folder) / "rows.jsonl"
        command = [COXSWAIN, "experiment", "compare", "--profile", profile, "--seeds", str(seeds)]
        command += ["--scenarios", ",".join(f"{name}+*" for name in scenarios)]
        command += ["--start", ",".join(starts), "--controllers", ",".join(controllers)]
        command += ["--json", rows] + (["--exact-sensors"] if sensors == "exact" else [])
        subprocess.run(command, cwd=HERE.parent, check=True, stdout=subprocess.DEVNULL)
        cells = {}
        for row in map(json.loads, rows.read_text().splitlines()):
            rmse = row["position_rmse_m"]
            key = table, profile, sensors, row["scenario"], row["controller"], row["start"]
            cell = cells.setdefault(key, ([], [], [], [], []))
            cell[0].append(math.inf if rmse is None else 1e3 * rmse)
            if row["scenario"].endswith("+payload"):
                recovery = row["recovery_s"]
                cell[1].append(row["duration_s"] if recovery is None else recovery)
            if row["interval"] is not None:
                for values, name in zip(cell[2:], ["coverage", "half_width", "residual_rms"]):
                    values.append(row["interval"][name])
    return [[*key, listed(rmse), listed(recovery)]
            + [listed(map(mean_of, zip(*of_axes))) for of_axes in of_interval]
            for key, (rmse, recovery, *of_interval) in cells.items()]


def listed(values):
    return " ".join(f"{value:.4g}" for value in values)


def mean_of(values):
    values = list(values)
    return sum(values) / len(values)


def bar(best):
    """The no-harm bar for the best baseline, both in mm."""
    return 1.05 * best + min(2.0, 0.2 * best)


def geometric_mean(ratios):
    ratios = list(ratios)
    return math.exp(sum(map(math.log, ratios)) / len(ratios)) if ratios else math.nan


def by_variant(rows):
    """Markdown of ours against the better least squares of each cell, by variant and start."""
    rmse = {(table, scenario, controller, start): mean_of(map(float, of.split()))
            for table, _, _, scenario, controller, start, of, *_ in rows}
    columns = [(table, start) for table in ["held-out-100", "held-out-20"] for start in BOTH]
    titles = [f"T = {table.rpartition('-')[2]} ms, {start}" for table, start in columns]
    lines = ["| variant | " + " | ".join(titles) + " |", "|---" * (len(columns) + 1) + "|"]
    variants = sorted({scenario.partition("+")[2] for table, scenario, *_ in rmse
                       if table == "held-out-100"})
    for variant in variants:
        ratios = []
        for table, start in columns:
            names = [f"{name}+{variant}".rstrip("+") for name in HELD_OUT]
            ratios.append(geometric_mean(
                rmse[table, name, OURS, start]
                / min(rmse[table, name, one, start] for one in LEAST_SQUARES) for name in names))
        cells = [f"{ratio:.2f}" for ratio in ratios]
        lines.append("| " + " | ".join([variant or "none"] + cells) + " |")
    return "\n".join(lines)


def table(rows):
    """Markdown of one table: a line per scenario, then the summary of the columns."""
    cells, columns, recoveries, coverages, widths = {}, [], {}, {}, {}
    for _, _, _, scenario, controller, start, *lists in rows:
        column = controller, start
        if column not in columns:
            columns.append(column)
        rmse, recovery, coverage, half_width, residual = (
            [float(value) for value in of.split()] for of in lists)
        cells[scenario, column] = rmse
        recoveries.setdefault(column, []).extend(recovery)
        if coverage:
            coverages.setdefault(column, {})[scenario] = mean_of(coverage)
            if half_width:
                shares = [of / rms for of, rms in zip(half_width, residual)]
                widths.setdefault(column, []).append(shares)
    columns.sort(key=lambda column: (ALL.index(column[0]), column[1]))
    scenarios = sorted({scenario for scenario, _ in cells})
    name = {OURS: "ours", "feedforward-p": "ff+P"}

    def base(controller, start):
        """The column of a baseline: of the same start if there is one, otherwise cold."""
        same = controller, start
        return same if controller in REMEMBER and same in columns else (controller, "cold")

    def title(column):
        controller, start = column
        known = f", {start}" if controller in REMEMBER else ""
        return name.get(controller, controller) + known

    def line(first, of):
        return "| " + " | ".join([first] + [of(column) for column in columns]) + " |"

    def mean(scenario, column, seeds=None):
        """Over the first seeds, which are those of a column with fewer of them."""
        return mean_of(cells[scenario, column][:seeds])

    def best(scenario, controllers, start, seeds):
        """The least error of some controllers in one cell."""
        return min(mean(scenario, base(one, start), seeds) for one in controllers)

    def ratio(column, controllers, keep=lambda scenario: True):
        """Geometric mean of the error over the least one of some controllers, on the same seeds."""
        ratios = []
        for scenario in filter(keep, scenarios):
            seeds = min(len(cells[scenario, of]) for of in
                        [column] + [base(one, column[1]) for one in controllers])
            least = best(scenario, controllers, column[1], seeds)
            ratios.append(mean(scenario, column, seeds) / least)
        return geometric_mean(ratios)

    def ratio_to(controllers, keep=lambda scenario: True):
        return lambda column: f"{ratio(column, controllers, keep):.2f}"

    def harm(column):
        if column[0] == ORACLE:
            return ""
        simple = [base(controller, column[1]) for controller in SIMPLE]
        seeds = len(cells[scenarios[0], column])
        shares = [mean(s, column) / bar(best(s, SIMPLE, column[1], seeds)) for s in scenarios]
        trials = [value > bar(min(cells[s, b][seed] for b in simple))
                  for s in scenarios for seed, value in enumerate(cells[s, column])]
        above = sum(share > 1 for share in shares)
        return f"{above} of {len(shares)}; {sum(trials)} of {len(trials)}"

    def closed(column):
        if (ORACLE, "cold") not in columns or column[0] in SIMPLE:
            return ""
        # Of the best baseline in each cell: below 0 % without any gain on it.
        gain = math.log(ratio(column, SIMPLE))
        whole = math.log(ratio((ORACLE, "cold"), SIMPLE))
        return f"{100 * gain / whole + 0.0:.0f} %"

    def back(column):
        times = sorted(recoveries.get(column, []))
        return f"{times[len(times) // 2]:.1f}; {times[-1]:.1f}" if times else ""

    def covered(column):
        shares = coverages.get(column)
        if not shares:
            return ""
        good = sum(0.93 <= share <= 0.97 for share in shares.values())
        least = min(shares, key=shares.get)
        return f"{good} of {len(shares)}; {100 * shares[least]:.1f} ({least})"

    def width(column):
        shares = [geometric_mean(of_axis) for of_axis in zip(*widths.get(column, []))]
        return " / ".join(f"{share:.2f}" for share in shares)

    lines = [line("scenario", title), "|---" * (len(columns) + 1) + "|"]
    for scenario in scenarios:
        lines.append(line(scenario, lambda column: f"{mean(scenario, column):.2f}"))
    for of in OBSERVERS + LEAST_SQUARES:
        lines.append(line(f"geometric mean, of {of}", ratio_to([of])))
    for title_of, of in [("observer", OBSERVERS), ("least squares", LEAST_SQUARES)]:
        lines.append(line(f"geometric mean, of the better {title_of} of each cell", ratio_to(of)))
    for of in ["mpc+observer", "rls-mpc+observer"]:
        without = ratio_to([of], lambda scenario: "delay" not in scenario)
        lines.append(line(f"of {of}, without delays", without))
    lines.append(line("gap from the best baseline to the oracle closed (logarithms)", closed))
    lines.append(line("above the bar of no harm: cells; trials", harm))
    lines.append(line("payload: back after, median; worst \\[s\\]", back))
    lines.append(line("coverage within 93 to 97 %; least \\[%\\]", covered))
    if widths:
        lines.append(line("half width of the interval, of the residual's RMS, by axis", width))
    return "\n".join(lines)


def kept():
    """The rows of the CSV."""
    with CSV.open(newline="") as file:
        return list(csv.reader(file))[1:]


def replace(measured):
    """Replaces the rows of these cells in the CSV. A measurement that is interrupted keeps them."""
    rows = kept()
    new = {tuple(row[:6]): row for row in measured}
    rows = [new.pop(tuple(row[:6]), row) for row in rows] + list(new.values())
    with CSV.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([FIELDS] + rows)


def main():
    if sys.argv[1:] != ["tables"]:
        for number in map(int, sys.argv[1:] or range(1, len(SETS) + 1)):
            one = SETS[number - 1]
            print(f"{number} of {len(SETS)}: {one[0]}, {one[6]} seeds", flush=True)
            replace(measured(*one))
    rows, page = kept(), PAGE.read_text()
    tables = {name: table([row for row in rows if row[0] == name])
              for name in dict.fromkeys(one[0] for one in SETS)}
    for name, body in (tables | {"variants": by_variant(rows)}).items():
        begin, end = f"<!-- table {name} -->", f"<!-- end of {name} -->"
        if begin not in page or end not in page:
            sys.exit(f"{PAGE}: expected the marks {begin} and {end}")
        page = re.sub(f"{begin}.*?{end}", lambda _: f"{begin}\n{body}\n{end}", page, flags=re.S)
    PAGE.write_text(page)


if __name__ == "__main__":
    main()
