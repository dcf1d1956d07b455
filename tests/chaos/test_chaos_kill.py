"""kill -9, SIGINT and SIGTERM at any touch of the disk: nothing is lost, the end is the same."""

import pytest
from chaos_driver import SIGNALS, stcal
from chaos_scene import LONG, STAGES, visible, whole


def points(n: int, short: int) -> list[int]:
    """Return touches to stop at, the last one too: all of them in the long form."""
    if LONG:
        return list(range(1, n + 1))
    return sorted({1 + (n - 1) * k // max(short - 1, 1) for k in range(short)})


def stop_everywhere(scene, stage: str, signal: str, short: int) -> None:
    scene.reset(stage)
    n = stcal(scene.command(stage)).touches
    for k in points(n, short):
        scene.reset(stage)
        stopped = stcal(scene.command(stage), signal, k)
        expected = -SIGNALS[signal] if signal == "SIGKILL" else 130
        assert stopped.code == expected, (k, stopped)
        whole(scene.work)
        if signal != "SIGKILL":
            assert "Traceback" not in stopped.err, (k, stopped.err)
            assert len(list(visible(scene.work))) == sum(
                path.is_file() for path in scene.work.rglob("*")
            )
        again = stcal(scene.command(stage))
        assert again.code == 0, (k, again)
        scene.end(stage)


@pytest.mark.parametrize("stage", STAGES)
def test_killed_at_any_touch(scene, stage):
    stop_everywhere(scene, stage, "SIGKILL", {"ingest": 4, "build": 4}.get(stage, 2))


@pytest.mark.parametrize("signal", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("stage", STAGES if LONG else ("ingest", "build"))
def test_interrupted_at_any_touch(scene, stage, signal):
    stop_everywhere(scene, stage, signal, 2)
