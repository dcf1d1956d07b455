"""A real Dask cluster of processes over loopback."""

import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path


def _started(*arguments: str) -> subprocess.Popen:
    # Out of the terminal's process group and quiet, as a service is.
    return subprocess.Popen(
        [sys.executable, "-m", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


@contextmanager
def cluster(folder: Path, workers: int):
    """Run a scheduler and workers of one thread each; yield the address and the workers."""
    from distributed import Client

    file = str(folder / "scheduler.json")
    common = ("--scheduler-file", file, "--no-dashboard", "--host", "127.0.0.1")
    processes = [_started("distributed.cli.dask_scheduler", *common, "--port", "0")]
    for _ in range(workers):
        processes.append(
            _started("distributed.cli.dask_worker", *common, "--nthreads", "1", "--no-nanny")
        )
    try:
        with Client(scheduler_file=file, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60)
            address = client.scheduler_info()["address"]
        yield address, processes[1:]
    finally:
        for process in processes:
            process.kill()
            process.wait()
