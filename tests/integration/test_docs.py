"""The documentation tells what is there: names, tests, commands, options, messages and code of every page."""

from __future__ import annotations

import ast
import importlib
import os
import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from locorl import table_i
from locorl.rewards import terms

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools" / "docs"))

from command_help import TOOLS, help_text, subcommands  # noqa: E402

PAGES = sorted(
    [*ROOT.glob("docs/*.md"), *ROOT.glob("packages/**/*.md"), ROOT / "README.md", ROOT / "studies/README.md"]
)
PAPER = ROOT / "docs" / "paper.md"
PACKAGES = ("morphgen", "locorl", "codesign_bo", "distill", "deploy", "legged_codesign")
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`([^`\n]+)`")
SHELL = ("", "sh", "bash", "console")


def pages() -> pytest.MarkDecorator:
    return pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))


def spans(page: Path) -> list[str]:
    """What stands in backticks outside blocks of code."""
    return CODE.findall(FENCE.sub("", page.read_text(encoding="utf-8")))


def resolve(name: str) -> object:
    """The object that a dotted name means; a function may hide the module of its own name."""
    parts = name.split(".")
    thing: object = importlib.import_module(parts[0])
    for index, part in enumerate(parts[1:], start=1):
        if not hasattr(thing, part):
            module = ".".join(parts[: index + 1])
            fields = getattr(thing, "__dataclass_fields__", {})
            thing = fields[part] if part in fields else importlib.import_module(module)
        else:
            thing = getattr(thing, part)
    return thing


@pages()
def test_every_name_of_the_code_exists(page: Path) -> None:
    pattern = re.compile(rf"(?:{'|'.join(PACKAGES)})(?:\.\w+)+")
    for name in filter(pattern.fullmatch, spans(page)):
        assert resolve(name) is not None, name


def test_every_test_of_the_paper_exists() -> None:
    named = [span for span in spans(PAPER) if span.startswith("tests/")]
    assert len(named) > 40
    for span in named:
        file, _, test = span.partition("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert not test or f"def {test}(" in text, span


def test_the_whole_paper_is_there() -> None:
    text = PAPER.read_text(encoding="utf-8")
    wanted = [f"eq. {n}" for n in range(1, 11)] + [f"Fig. {n}" for n in range(1, 10)]
    wanted += ["Table I:", "Table II:", "Table III:", "Table IV,", "Algorithm 1", "Algorithm 2"]
    wanted += ["III-A.", "III-B.", "III-C.", "III-D.", "IV-A.", "IV-B.", "IV-C."]
    assert [part for part in wanted if part not in text] == []


@pytest.mark.parametrize("task", ["locomotion", "parkour"])
def test_every_term_of_table_i_is_mapped(task: str) -> None:
    weights = {name: value for name, value in vars(table_i(task)).items() if hasattr(terms, name) and value}
    assert len(weights) == 12  # the paper has twelve in each column
    text = PAPER.read_text(encoding="utf-8")
    assert [name for name in weights if f"`locorl.rewards.terms.{name}`" not in text] == []


def commands(page: Path) -> list[list[str]]:
    """Command lines of our tools on a page, in blocks and in backticks, as words."""
    text = page.read_text(encoding="utf-8")
    lines = [body.replace("\\\n", " ") for language, body in FENCE.findall(text) if language in SHELL]
    found = []
    for line in [*"\n".join(lines).splitlines(), *spans(page)]:
        line = line.split("  #")[0].split(" # ")[0].strip().removeprefix("$ ")
        line = re.sub(r"\[([^\]]*)\]", r"\1", line)  # optional parts
        tool = line.split(" ")[0]
        if tool in TOOLS and " " in line:
            found.append(shlex.split(line.replace("...", "")))
    return found


@cache
def known_options(tool: str, subcommand: str) -> set[str]:
    return {
        option.replace("_", "-") for option in re.findall(r"(?<![\w-])--?[a-zA-Z][\w.-]*", help_text(tool, subcommand))
    }


@pages()
def test_every_command_parses(page: Path) -> None:
    for words in commands(page):
        tool, subcommand, *rest = words
        if subcommand.startswith("-"):
            assert subcommand == "--help", words
            continue
        alternatives = words[1::2] if "|" in words else [subcommand]  # `distill train | evaluate`
        assert set(alternatives) <= set(subcommands(tool)), words
        assert not set(options(rest)) - known_options(tool, subcommand), words


def test_a_command_that_is_not_there_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```sh\nlocorl train runs/x --iterations 3  # --no\n```\n`codesign run --no-such-option 1`\n")
    train, run = commands(page)
    assert not set(options(train)) - known_options("locorl", "train")
    assert set(options(run)) - known_options("codesign", "run") == {"--no-such-option"}


def options(words: list[str]) -> list[str]:
    names = [word.split("=")[0].rstrip(";,") for word in words if re.match(r"--?[a-zA-Z]", word)]
    return [name.replace("_", "-") for name in names]


@pages()
def test_python_compiles(page: Path) -> None:
    for language, body in FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            compile(body, str(page), "exec")


@cache
def literals() -> str:
    """Every text in the sources, variable parts as one sign, one text a line."""
    texts = []
    for source in (ROOT / "src", *ROOT.glob("packages/*/src")):
        for file in source.rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.JoinedStr):
                    parts = [str(p.value) if isinstance(p, ast.Constant) else "\0" for p in node.values]
                    texts.append("".join(parts))
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    texts.append(node.value)
    return "\n".join(" ".join(text.split()) for text in texts)


def test_messages_of_the_troubleshooting_page_are_those_of_the_code() -> None:
    quoted = re.findall(
        r"^### `(.+)`$", (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(quoted) > 10
    for message in quoted:
        pattern = ".*".join(re.escape(part.strip()) for part in message.split("...") if part.strip())
        assert re.search(pattern, literals()), message


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_no_link_is_broken(tmp_path: Path) -> None:
    site = tmp_path / "site"
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(site)]
    done = subprocess.run(build, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    for page in ("index.html", "paper.html", "packages/deploy/GUIDE.html", "api/locorl/index.html"):
        assert (site / page).is_file(), page
    check = [sys.executable, str(ROOT / "tools" / "docs" / "check_links.py"), str(site)]
    done = subprocess.run(check, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
