"""The doctor finds what is wrong with a machine, and says what to do: each bad finding on a machine made to have it."""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path

import pytest

from legged_codesign.doctor import examine, graphics, machine, software
from legged_codesign.doctor.graphics import Ended
from legged_codesign.doctor.machine import Cgroup

ROOT = Path(__file__).parents[2]


def answers(*ends: Ended) -> graphics.Runner:
    """A runner that gives these answers, one after the other."""
    rest = list(ends)

    def run(command: Sequence[str], environment: Mapping[str, str]) -> Ended:
        return rest.pop(0)

    return run


def test_a_container_that_gets_less_time_than_it_sees_cores() -> None:
    found = machine.check_cores(8, 16, Cgroup(cores=1.5))
    assert found.status == "warn"
    assert "8 cores" in found.text
    assert "1.5" in found.text
    assert machine.check_cores(2, 16, Cgroup(cores=2.0)).status == "ok"
    assert machine.check_cores(1, 16, Cgroup()).status == "warn"


def test_limits_of_this_group_and_of_those_around_it_are_read(tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.write_text("0::/a/b\n")
    group = tmp_path / "cgroup" / "a" / "b"
    group.mkdir(parents=True)
    (group / "cpu.max").write_text("400000 100000\n")
    (group.parent / "cpu.max").write_text("150000 100000\n")  # the outer one is tighter
    (group / "memory.max").write_text("max\n")
    (group.parent / "memory.max").write_text("3000000000\n")
    (group.parent / "memory.current").write_text("1000000000\n")
    assert machine.read_cgroup(tmp_path / "cgroup", own) == Cgroup(cores=1.5, memory_gb=2.0)
    assert machine.read_cgroup(tmp_path / "cgroup", tmp_path / "none") == Cgroup()


@pytest.mark.parametrize(
    ("threads", "status", "way_out"),
    [(8, "warn", "OMP_NUM_THREADS=4"), (1, "warn", "set it to 4"), (4, "ok", "")],
)
def test_threads_that_do_not_fit_the_cores(threads: int, status: str, way_out: str) -> None:
    found = machine.check_threads(threads, 4, {"OMP_NUM_THREADS": str(threads)})
    assert (found.status, f"OMP_NUM_THREADS={threads}" in found.text) == (status, True)
    assert way_out in found.remedy


@pytest.mark.parametrize(
    ("available", "limit", "status"),
    [(16.0, None, "ok"), (3.0, None, "warn"), (0.5, None, "fail"), (64.0, 1.0, "fail"), (1.0, 64.0, "fail")],
)
def test_memory_that_does_not_suffice(available: float, limit: float | None, status: str) -> None:
    found = machine.check_memory(available, Cgroup(memory_gb=limit))
    assert found.status == status
    assert ("container" in found.remedy) == (limit == 1.0)
    assert f"{min(available, limit or available):.1f} GB" in found.text


def test_a_full_disk_and_a_folder_that_nobody_may_write_to(tmp_path: Path) -> None:
    folder = tmp_path / "not" / "yet"
    assert machine.check_disk(folder).status in ("ok", "warn")  # measured
    assert not folder.exists()
    assert machine.check_disk(folder, free_gb=0.1).status == "fail"
    assert machine.check_disk(folder, free_gb=2.0).status == "warn"
    refused = machine.check_disk(folder, writable=False)
    assert (refused.status, str(folder) in refused.text) == ("fail", True)
    file = tmp_path / "file"
    file.write_text("")
    assert machine.check_disk(file / "runs").status == "fail"


def test_a_network_file_system(tmp_path: Path) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/sda / ext4 rw 0 0\nserver:/home {tmp_path} nfs4 rw 0 0\n")
    found = machine.check_file_system(tmp_path / "runs", mounts)
    assert found.status == "fail"
    assert "nfs4" in found.text
    assert "--study" in found.remedy
    assert machine.check_file_system(Path("/elsewhere"), mounts).status == "ok"


def test_a_frame_is_really_rendered_in_a_process_of_its_own() -> None:
    run = graphics.execute([sys.executable, "-c", "import os; os.abort()"], {})
    assert run.reason == "the process died of SIGABRT"
    assert graphics.execute(["/no/such/program"], {}).status != 0
    assert "No module" in graphics.execute([sys.executable, "-c", "import no_such_module"], {}).reason


def test_opengl_that_crashes_draws_black_or_is_missing() -> None:
    crash, black = Ended(-11), Ended(0, "0\n")
    found = graphics.check_opengl(answers(crash, black), {})
    assert found.status == "warn"  # a run draws stick figures then
    assert "egl: the process died of SIGSEGV" in found.text
    assert "osmesa: the frame is black" in found.text
    assert "libegl1" in found.remedy
    second = graphics.check_opengl(answers(crash, Ended(0, "200\n")), {})
    assert (second.status, "MUJOCO_GL=osmesa" in second.text) == ("warn", True)
    chosen = graphics.check_opengl(answers(Ended(1, "", "RuntimeError: invalid value")), {"MUJOCO_GL": "glx"})
    assert "invalid value" in chosen.text
    assert "unset it" in chosen.remedy


def gpu(**found: object) -> graphics.Runner:
    told = {"torch": "2.13.0", "cuda": "13.0", "devices": [], "warp": None, **found}
    return answers(Ended(0, "a greeting of the library\n" + json.dumps(told) + "\n"))


@pytest.mark.parametrize(
    ("run", "nvidia", "status", "says"),
    [
        (gpu(cuda=None), False, "ok", "none"),
        (gpu(cuda=None), True, "warn", "without CUDA"),
        (gpu(), True, "warn", "finds no GPU"),
        (gpu(devices=[["H100", 70.0]]), True, "warn", "Warp is not installed"),
        (gpu(devices=[["H100", 70.0]], warp=[]), True, "warn", "does not see it"),
        (gpu(devices=[["H100", 70.0]], warp=["cuda:0"]), True, "ok", "H100 with 70 GB free"),
        (answers(Ended(-6)), True, "warn", "SIGABRT"),
    ],
)
def test_gpu(run: graphics.Runner, nvidia: bool, status: str, says: str) -> None:
    found = graphics.check_gpu(run, nvidia)
    assert (found.status, says in found.text) == (status, True)


def test_no_ffmpeg() -> None:
    def none() -> str:
        raise RuntimeError("No ffmpeg exe could be found.")

    assert graphics.check_ffmpeg(answers(), none).status == "fail"
    assert graphics.check_ffmpeg(answers(Ended(127, "", "not for this processor")), lambda: "/x").status == "fail"
    good = graphics.check_ffmpeg(answers(Ended(0, "ffmpeg version 9.0.2 Copyright\n")), lambda: "/x")
    assert good.text == "9.0.2 at /x"


def installed(versions: Mapping[str, str]) -> Callable[[str], str]:
    def version(name: str) -> str:
        if name not in versions:
            raise metadata.PackageNotFoundError(name)
        return versions[name]

    return version


def test_python_and_packages_that_do_not_fit() -> None:
    assert software.check_python("3.10.4", ">=3.11").status == "fail"
    assert software.check_python("3.13.0rc1", ">=3.11").status == "ok"
    required = [("ours", "torch>=2.9"), ("ours", "mujoco>=4.0,<5"), ("ours", "ray>=2; extra == 'ray'")]
    versions = {"torch": "2.13.0+cpu", "mujoco": "3.4.0", "numpy": "2.0"}
    (old,) = software.check_packages(required, installed(versions))
    assert "ours needs mujoco<5,>=4.0, and 3.4.0 is installed" in old.text
    assert old.remedy == "pip install 'mujoco<5,>=4.0'"
    (missing,) = software.check_packages(required, installed({"torch": "2.13.0", "numpy": "2.0"}))
    assert "not installed" in missing.text


def test_every_extra_has_a_purpose_and_is_looked_for() -> None:
    declared = set()
    for file in (ROOT / "pyproject.toml", *ROOT.glob("packages/*/pyproject.toml")):
        project = tomllib.loads(file.read_text())["project"]
        declared |= {(project["name"], extra) for extra in project.get("optional-dependencies", {})}
    ours = {key for key in declared if not key[1].startswith(("test", "dev", "docs"))}
    assert ours == set(software.EXTRAS)
    nothing = software.check_extras(installed({}))
    assert {f.status for f in nothing} == {"ok"}
    assert any("Ray" in f.text and f.remedy == "pip install 'legged-codesign-bo[ray]'" for f in nothing)


def test_a_robot_that_cannot_be_loaded() -> None:
    points = [metadata.EntryPoint("go2", "no_such_package:go2", "legged.bodies")]
    found = software.check_robots(points)
    assert found.status == "fail"
    assert "no_such_package" in found.text
    assert "lite3" in found.text
    assert software.check_robots().status == "ok"


def test_a_shipped_policy_that_is_damaged_or_another(tmp_path: Path) -> None:
    source = software.shipped_policies()["go2-flat"]
    policy = tmp_path / "policy.pt"
    policy.write_bytes(source.read_bytes()[:1000])
    provenance = tmp_path / "provenance.json"
    provenance.write_text((source.parent / "provenance.json").read_text())
    (damaged,) = software.check_policies({"mine": policy})
    assert damaged.status == "fail"
    assert "mine cannot be read" in damaged.text
    policy.write_bytes(source.read_bytes())
    assert software.check_policies({"mine": policy})[0].status == "ok"
    provenance.write_text('{"samples": 1}')
    assert "its provenance says 1" in software.check_policies({"mine": policy})[0].text
    assert software.check_policies({})[0].status == "fail"


def test_command_prints_every_finding_and_fails_if_one_fails(
    codesign: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    code, out = codesign("doctor", "--json", "--folder", tmp_path / "runs")
    findings = json.loads(out)
    assert {f["topic"] for f in findings} >= {
        "cores",
        "threads",
        "memory",
        "disk",
        "GPU",
        "OpenGL",
        "packages",
        "robots",
    }
    assert code == any(f["status"] == "fail" for f in findings)
    blocked = tmp_path / "file"
    blocked.write_text("")
    code, out = codesign("doctor", "--folder", blocked)
    assert code == 1
    assert "cannot be written to" in " ".join(out.split())


def test_probes_reach_every_check_of_the_machine(tmp_path: Path) -> None:
    from legged_codesign.doctor import Probes

    probes = Probes(lambda: (8, 8), lambda: 64, lambda: 0.1, lambda: Cgroup(cores=1.0), run=lambda *_: Ended(-9))
    status = {f.topic: f.status for f in examine(tmp_path, probes)}
    assert (status["cores"], status["threads"], status["memory"], status["ffmpeg"]) == ("warn", "warn", "fail", "fail")
    assert (status["GPU"], status["OpenGL"]) == ("warn", "warn")
