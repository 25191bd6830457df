"""What the generator calls: puts the READMEs, the pages made from the product and all that they link to on the site."""

from pathlib import Path

from properdocs.config.defaults import ProperDocsConfig
from properdocs.structure.files import File, Files

from racerl.docs import api, commands, effects, sources
from racerl.docs.markdown import links


def on_files(files: Files, config: ProperDocsConfig) -> Files:
    """Put all pages where they stand in the repository, those that are made into folders of their own."""
    for file in list(files.documentation_pages()):
        files.remove(file)
    for place, text in {**commands.pages(), **effects.pages(), **api.pages()}.items():
        files.append(File.generated(config, place, content=text))
    for place, path in {**sources.readmes(), **_linked()}.items():
        files.append(File.generated(config, place, abs_src_path=str(path)))
    return files


def _linked() -> dict[str, Path]:
    """Return the files that READMEs lead to or show, READMEs apart."""
    named = [
        page.parent / link.partition("#")[0] for page in sources.readmes().values() for link in links(page.read_text())
    ]
    there = {file.resolve() for file in named if file.is_file() and file.name != "README.md"}
    return {file.relative_to(sources.ROOT.resolve()).as_posix(): file for file in sorted(there)}
