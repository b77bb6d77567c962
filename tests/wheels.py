"""Ask the package index for wheels of all dependencies, on every system (`make wheels`).

Prints a table for docs/architecture.md: what is only Python runs everywhere, so that only compiled
packages are asked for, also those that dependencies need. ``pip index versions`` reads the page of
a package; nothing is downloaded or installed."""

import json
import subprocess
import sys
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, distribution
from itertools import product, repeat

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import Version

_GLIBC = 28  # 2.28: Debian 10, Ubuntu 20.04 and Red Hat 8 have it or a newer one
_MANYLINUX = [*(f"manylinux_2_{minor}" for minor in range(5, _GLIBC + 1)), "manylinux2014"]
SYSTEMS = {
    "Linux x86-64": [f"{name}_x86_64" for name in _MANYLINUX],
    "Linux arm64": [f"{name}_aarch64" for name in _MANYLINUX],
    "Windows x86-64": ["win_amd64"],
    "macOS arm64": ["macosx_14_0_arm64"],
    "macOS x86-64": ["macosx_14_0_x86_64"],
}
PYTHONS = ("3.11", "3.12", "3.13")
_DEVELOPMENT = ("dev", "docs", "app")  # extras for those who change the program
_AT_A_TIME = 3  # questions to the index


def _needed(extras: Iterable[str]) -> dict[str, str]:
    """Version, "" = not installed here, of all packages that the program needs with ``extras``."""
    found: dict[str, str] = {}
    left = [("gaga-studio", frozenset(extras))]
    while left:
        name, wanted = left.pop()
        try:
            package = distribution(name)
        except PackageNotFoundError:
            found[name] = ""
            continue
        found[name] = str(Version(package.version).public)
        for line in package.requires or ():
            needed = Requirement(line)
            places = [{"extra": extra} for extra in (wanted or [""])]
            key = canonicalize_name(needed.name)
            is_on = needed.marker is None or any(needed.marker.evaluate(p) for p in places)
            if is_on and (key not in found or not needed.extras <= set()):
                left.append((key, frozenset(needed.extras)))
                found.setdefault(key, "")
    del found["gaga-studio"]
    return found


def _is_plain(name: str) -> bool:
    """Whether the installed package is only Python, of all versions that we ask for."""
    package = distribution(name)
    runs = SpecifierSet(package.metadata["Requires-Python"] or "")
    wheel = package.read_text("WHEEL") or ""
    return "none-any" in wheel and all(f"{python}.9" in runs for python in PYTHONS)


def _has_wheel(name: str, system: str, python: str, packages: Mapping[str, str]) -> bool:
    """Whether the index has a wheel of the version of ``packages``, any where it is ""."""
    version = packages[name]
    command = [sys.executable, "-m", "pip", "index", "versions", name, "--json"]
    command += ["--disable-pip-version-check", "--only-binary=:all:", "--python-version", python]
    command += [part for tag in SYSTEMS[system] for part in ("--platform", tag)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        if "No matching distribution" not in done.stderr:
            raise SystemExit(done.stderr)
        return False
    versions = json.loads(done.stdout)["versions"]
    return not version or any(Version(v).public == version for v in versions)


def _table(found: dict[tuple[str, str, str], bool], packages: dict[str, str]) -> str:
    """A line for each package; "all" where every Python has a wheel, else those that have."""
    lines = ["| package | " + " | ".join(SYSTEMS) + " |", "|---" * (len(SYSTEMS) + 1) + "|"]
    for name in sorted(packages):
        cells = []
        for system in SYSTEMS:
            has = [python for python in PYTHONS if found[name, system, python]]
            cells.append("all" if len(has) == len(PYTHONS) else ", ".join(has) or "none")
        lines.append(f"| {name} {packages[name]} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    everything = set(distribution("gaga-studio").metadata.get_all("Provides-Extra") or ())
    use = _needed(everything - set(_DEVELOPMENT))
    found: dict[tuple[str, str, str], bool] = {}
    for title, all_of in (("use", use), ("change", _needed(everything))):
        packages = {n: v for n, v in all_of.items() if title == "use" or n not in use}
        packages = {n: v for n, v in packages.items() if not v or not _is_plain(n)}
        asked = list(product(packages, SYSTEMS, PYTHONS))
        with ThreadPoolExecutor(_AT_A_TIME) as pool:
            answers = pool.map(_has_wheel, *zip(*asked, strict=True), repeat(packages))
            found |= dict(zip(asked, answers, strict=True))
        text = f"To {title} the program, of {len(all_of)} packages those that are compiled:"
        sys.stdout.write(f"\n{text}\n\n{_table(found, packages)}\n")


if __name__ == "__main__":
    main()
