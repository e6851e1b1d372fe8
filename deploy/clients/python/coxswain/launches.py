"""The launches that run on this machine, and the way to the processes of one."""

import os
import tomllib
from dataclasses import dataclass
from pathlib import Path

from .requests import Files, Network, RequestError, Way


@dataclass(frozen=True)
class Launch:
    """A launch that runs on this machine."""

    run: Path
    """Its run directory."""
    endpoints: tuple[str, ...]
    """Of its gateway; empty without one."""
    links: Path
    """The directory of its links."""


def running_launches() -> list[Launch]:
    """The launches of this user that run on this machine."""
    base = Path(os.environ.get("TMPDIR", "/tmp")) / f"coxswain-{os.getuid()}"
    found = []
    for entry in sorted(base.glob("*.toml")):
        graph = entry.with_suffix("")
        try:
            launcher = tomllib.loads(entry.read_text())
            run = Path(os.fsdecode((graph / "run").read_bytes()))
        except (OSError, tomllib.TOMLDecodeError):
            continue  # it ends or begins at this moment
        if _start_ticks(launcher.get("pid")) != launcher.get("start_ticks"):
            continue
        telemetry = graph / "telemetry"
        endpoints = telemetry.read_text().split() if telemetry.exists() else []
        found.append(Launch(run, tuple(endpoints), graph))
    return found


def running_launch(run: Path | None = None) -> Launch:
    """The launch with this run directory, or the only one that runs. Raises RequestError."""
    found = running_launches()
    if run is not None:
        found = [launch for launch in found if launch.run == run.resolve()]
    if len(found) != 1:
        names = ", ".join(str(launch.run) for launch in found) or "none"
        raise RequestError(f"expected one launch that runs on this machine, found {names}")
    return found[0]


def way_to(launch: Launch | None, at: str | None, certificates: Path | None) -> Way:
    """The way to a launch of this machine, or to the host `at` with certificates."""
    if launch is not None and at is None and certificates is None:
        return Files(launch.run)
    if launch is None and at is not None and certificates is not None:
        return Network(at, certificates)
    raise TypeError("expected a launch, or an address with certificates")


def _start_ticks(pid: object) -> int | None:
    """Start time of a process that runs: with its id it is unique."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    state, *fields = stat.rpartition(")")[2].split()
    return None if state in "ZX" else int(fields[18])
