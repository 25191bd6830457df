"""The pages that are written by hand: the READMEs, on the site where they stand in the repository."""

from pathlib import Path

from racerl.documents import conf_folder

ROOT = conf_folder().parent  # of the checkout
FOLDERS = ("conf", "outputs/reference", "racerl", "sweeps", "tests")


def readmes() -> dict[str, Path]:
    """Return the READMEs by their place, the project's own first."""
    found = [ROOT / "README.md", *(page for folder in FOLDERS for page in sorted((ROOT / folder).rglob("README.md")))]
    return {page.relative_to(ROOT).as_posix(): page for page in found}
