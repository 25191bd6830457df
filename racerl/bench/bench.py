"""The bench stage: runs one benchmark and writes its numbers with machine, threads and git sha."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from racerl import bench as package
from racerl import registry
from racerl.assemble import use_threads
from racerl.bench import Benchmark, Compose, Progress
from racerl.documents import write_json
from racerl.run import RunFolder
from racerl.vehicle.rollout import on_threads

RESULT = "bench.json"


def bench(
    settings: Mapping[str, Any], out: Path, compose: Compose, on_progress: Progress = lambda share, what: None
) -> dict[str, Any]:
    """Run the benchmark `settings["benchmark"]` names; return what was written to bench.json."""
    use_threads(settings["threads"])
    benchmark: Benchmark = registry.create(package, settings["benchmark"])
    folder = RunFolder.start(out, "bench", settings, threads=settings["threads"])
    with on_threads(settings["threads"]):
        measured = benchmark.measure(compose, settings["threads"], on_progress)
    facts = {
        "benchmark": settings["benchmark"]["name"],
        **measured,
        "threads": settings["threads"],
        **{key: folder.manifest[key] for key in ("cpu", "cpu_count", "git_sha", "libraries")},
    }
    write_json(folder.path / RESULT, facts)
    folder.finish()
    return facts
