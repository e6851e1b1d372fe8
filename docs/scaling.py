"""Draws the time of one control step over the horizon and over the number of data points.

Reads the JSON lines of the bench of the reference problem.

Needs python3. From the project's root:

    bench() { taskset -c 1 cargo bench -q --workspace --bench reference_problem -- $1 $2; }
    { for n in 5 10 15 20 25 30 35 40; do bench 100 $n; done
      for m in 0 100 200 500 1000 1500 2000; do bench $m 10; done; } |
        python3 docs/scaling.py docs/images/scaling.svg
"""
import json
import sys

WIDTH, HEIGHT, LEFT, TOP, ACROSS, DOWN = 760, 320, 60, 40, 290, 220
PARTS = [("step_p50_us", "step", "#1f4e79"), ("qp_p50_us", "quadratic program", "#b5651d"),
         ("linearise_p50_us", "linearise, with the GP", "#3a7d44"),
         ("feedback_p50_us", "state to command", "#888888")]


def round_up(value):
    step = 10 ** (len(str(int(value))) - 1)
    return (int(value / step) + 1) * step


def panel(rows, key, title, left):
    rows = sorted(rows, key=lambda row: row[key])
    largest = max(row[key] for row in rows)
    highest = round_up(max(row["step_p50_us"] for row in rows))

    def place(row, part):
        return left + ACROSS * row[key] / largest, TOP + DOWN * (1 - row[part] / highest)

    out = [f'<text x="{left}" y="{TOP - 14}" font-weight="bold">{title}</text>',
           f'<path d="M{left},{TOP}v{DOWN}h{ACROSS}" fill="none" stroke="#444"/>']
    for share in (0, 0.25, 0.5, 0.75, 1):
        x, y = left + ACROSS * share, TOP + DOWN * (1 - share)
        out.append(f'<text x="{left - 6}" y="{y + 4}" text-anchor="end">{highest * share:g}</text>')
        out.append(f'<text x="{x}" y="{TOP + DOWN + 16}" text-anchor="middle">'
                   f'{largest * share:g}</text>')
        out.append(f'<path d="M{left},{y}h{ACROSS}" stroke="#ddd"/>')
    for part, _, colour in PARTS:
        points = [place(row, part) for row in rows]
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        out.append(f'<polyline points="{corners}" fill="none" stroke="{colour}"'
                   f' stroke-width="2"/>')
        out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{colour}"/>' for x, y in points]
    return out


def main():
    rows = [json.loads(line) for line in sys.stdin if line.startswith("{")]
    picture = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}"'
               f' font-family="sans-serif" font-size="11">',
               f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>']
    picture += panel([row for row in rows if row["M"] == 100], "N", "µs over N, 100 points", LEFT)
    picture += panel([row for row in rows if row["N"] == 10], "M", "µs over M, ten periods",
                     LEFT + ACROSS + 80)
    for i, (_, name, colour) in enumerate(PARTS):
        x = LEFT + 175 * i
        picture.append(f'<path d="M{x},{HEIGHT - 14}h18" stroke="{colour}" stroke-width="2"/>')
        picture.append(f'<text x="{x + 24}" y="{HEIGHT - 10}">{name}</text>')
    with open(sys.argv[1], "w", encoding="utf-8") as file:
        file.write("\n".join(picture + ["</svg>"]) + "\n")


if __name__ == "__main__":
    main()
