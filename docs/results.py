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
SIMPLE = ["feedforward-p", "mpc", "mpc+observer", "mpc+kalman", "rls-mpc+observer",
          "physics-mpc+observer"]
ALL = SIMPLE + ["gpr-mpc", OURS, ORACLE]
# A warm run of these starts with the model of an earlier run.
REMEMBER = ["rls-mpc+observer", "physics-mpc+observer", "gpr-mpc", OURS]
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
          "recovery_s_of_each_seed", "coverage_of_each_axis"]


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
            cell = cells.setdefault(key, ([], [], []))
            cell[0].append(math.inf if rmse is None else 1e3 * rmse)
            if row["scenario"].endswith("+payload"):
                recovery = row["recovery_s"]
                cell[1].append(row["duration_s"] if recovery is None else recovery)
            if row["coverage"] is not None:
                cell[2].append(row["coverage"])
    return [[*key, listed(rmse), listed(recovery), listed(map(mean_of, zip(*coverage)))]
            for key, (rmse, recovery, coverage) in cells.items()]


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


def table(rows):
    """Markdown of one table: a line per scenario, then the summary of the columns."""
    cells, columns, recoveries, coverages = {}, [], {}, {}
    for _, _, _, scenario, controller, start, *lists in rows:
        column = controller, start
        if column not in columns:
            columns.append(column)
        rmse, recovery, coverage = ([float(value) for value in of.split()] for of in lists)
        cells[scenario, column] = rmse
        recoveries.setdefault(column, []).extend(recovery)
        if coverage:
            coverages.setdefault(column, {})[scenario] = mean_of(coverage)
    columns.sort(key=lambda column: (ALL.index(column[0]), column[1]))
    scenarios = sorted({scenario for scenario, _ in cells})
    mean = {key: mean_of(values) for key, values in cells.items()}
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

    def ratio_to(controller, keep=lambda scenario: True):
        def ratio(column):
            other = base(controller, column[1])
            return "{:.2f}".format(geometric_mean(
                mean[scenario, column] / mean[scenario, other] for scenario in scenarios
                if keep(scenario) and (scenario, column) in mean))
        return ratio

    def harm(column):
        if column[0] == ORACLE:
            return ""
        simple = [base(controller, column[1]) for controller in SIMPLE]
        shares = [mean[s, column] / bar(min(mean[s, b] for b in simple)) for s in scenarios]
        trials = [value > bar(min(cells[s, b][seed] for b in simple))
                  for s in scenarios for seed, value in enumerate(cells[s, column])]
        above = sum(share > 1 for share in shares)
        return f"{above} of {len(shares)}; {sum(trials)} of {len(trials)}"

    def closed(column):
        if (ORACLE, "cold") not in columns:
            return ""
        of = ratio_to("mpc+observer")
        gain, whole = (math.log(float(of(column))) for column in (column, (ORACLE, "cold")))
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

    lines = [line("scenario", title), "|---" * (len(columns) + 1) + "|"]
    for scenario in scenarios:
        lines.append(line(scenario, lambda column: f"{mean[scenario, column]:.2f}"))
    for of in ["mpc+observer", "mpc+kalman", "rls-mpc+observer", "physics-mpc+observer"]:
        lines.append(line(f"geometric mean, of {of}", ratio_to(of)))
    for of in ["mpc+observer", "rls-mpc+observer"]:
        without = ratio_to(of, lambda scenario: "delay" not in scenario)
        lines.append(line(f"of {of}, without delays", without))
    lines.append(line("gap to the oracle closed (logarithms)", closed))
    lines.append(line("above the bar of no harm: cells; trials", harm))
    lines.append(line("payload: back after, median; worst \\[s\\]", back))
    lines.append(line("coverage within 93 to 97 %; least \\[%\\]", covered))
    return "\n".join(lines)


def replace(measured):
    """Replaces the rows of these cells in the CSV. A measurement that is interrupted keeps them."""
    with CSV.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
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
    with CSV.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    page = PAGE.read_text()
    for name in dict.fromkeys(one[0] for one in SETS):
        begin, end = f"<!-- table {name} -->", f"<!-- end of {name} -->"
        if begin not in page or end not in page:
            sys.exit(f"{PAGE}: expected the marks {begin} and {end}")
        body = table([row for row in rows if row[0] == name])
        page = re.sub(f"{begin}.*?{end}", lambda _: f"{begin}\n{body}\n{end}", page, flags=re.S)
    PAGE.write_text(page)


if __name__ == "__main__":
    main()
