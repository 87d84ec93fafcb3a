"""Install each package alone in a fresh environment, with only its [test] extra, and run its tests there."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
SIBLINGS = {"morphgen", "locorl", "codesign_bo", "distill", "deploy"}


def test_alone(package: str, folder: Path) -> bool:
    """Whether `packages/<package>` installs and passes its tests in an environment at `folder`."""
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    requirement = f"{ROOT / 'packages' / package}[test]"
    install = (python, "-m", "pip", "install", "--quiet", "--constraint", ROOT / "constraints.txt")
    # torch first: a package index may offer a build with gigabytes of GPU libraries
    project = tomllib.loads((ROOT / "packages" / package / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    if any(line.startswith("torch") for line in needed):
        subprocess.run((*install, "torch"), check=True)
    subprocess.run((*install, requirement), check=True)
    others = SIBLINGS - {package}
    check = (
        f"import importlib.util as u; found = [m for m in {sorted(others)} if u.find_spec(m)]; assert not found, found"
    )
    subprocess.run((python, "-c", check), check=True, cwd=folder)
    # run from elsewhere, so that the installed package is tested and not the checkout
    command = (python, "-m", "pytest", "-q", "-c", ROOT / "pyproject.toml", ROOT / "tests" / package)
    # in one piece, as other tests may be printing at the same time
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    print(done.stdout, flush=True)
    return done.returncode == 0


def main() -> None:
    """Test the packages named on the command line."""
    failed = []
    for package in sys.argv[1:]:
        started = time.monotonic()
        print(f"== {package} alone", flush=True)
        with tempfile.TemporaryDirectory(prefix=f"alone-{package}-") as folder:
            try:
                passed = test_alone(package, Path(folder))
            except subprocess.CalledProcessError as error:
                print(error)
                passed = False
        print(f"== {package} {'passed' if passed else 'FAILED'} in {time.monotonic() - started:.0f} s", flush=True)
        failed += [] if passed else [package]
    sys.exit(f"failed alone: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
