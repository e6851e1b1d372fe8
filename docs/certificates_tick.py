"""Control tick over the network with certificates and without, in turns: python3 docs/certificates_tick.py [ROUNDS [SECONDS [COXSWAIN]]]"""

import json
import pathlib
import statistics
import subprocess
import sys
import tempfile

rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 8
seconds = sys.argv[2] if len(sys.argv) > 2 else "10"
coxswain = sys.argv[3] if len(sys.argv) > 3 else "target/release/coxswain"
graph = str(pathlib.Path(__file__).parent.parent / "deploy/graphs/network.toml")
taken = {"without": [], "with": []}
with tempfile.TemporaryDirectory() as folder:
    given = f"{folder}/certificates"
    subprocess.run([coxswain, "certificates", "--robot", "mecanum", "--out", given], check=True, stdout=subprocess.DEVNULL)
    for number in range(rounds):
        for kind, options in sorted({"without": [], "with": ["--certificates", given]}.items(), reverse=number % 2 == 1):
            out = f"{folder}/{number}-{kind}"
            launch = [coxswain, "launch", graph, "--scenario", "paper-20ms", "--duration", seconds, "--out", out, *options]
            subprocess.run(launch, check=True, capture_output=True)
            summary = json.loads(pathlib.Path(f"{out}/summary.json").read_text())
            taken[kind].append(summary["tick_p50_us"])
            print(f"{kind:8} p50 {summary['tick_p50_us']:.0f} us, p99 {summary['tick_p99_us']:.0f} us, missed {summary['periods_missed']}", flush=True)
medians = {kind: statistics.median(values) for kind, values in taken.items()}
print(f"median of p50: without {medians['without']:.1f} us, with {medians['with']:.1f} us, ratio {medians['with'] / medians['without']:.3f}")
