"""A folder of files with checksums, which is replaced as a whole or not at all.

`analysis.json` is the manifest: format, version, and for each file its name here (as in `summary-1f2e3d4c.parquet`), size and
SHA-256. It is written last, so that it always names the complete files of one save.
"""

from __future__ import annotations

import hashlib
import json
import re
import secrets
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from polars.exceptions import PolarsError

from dds_trace.base.errors import OutputError, OutputExistsError, TraceFormatError
from dds_trace.base.files import open_regular, read_regular, replacing
from dds_trace.base.version import __version__

from .records import from_json

MANIFEST = "analysis.json"
FORMAT = "dds-trace analysis"
VERSION = 7
"""Another version is refused."""

_FILE_NAME = re.compile(r"[a-z_]+-[0-9a-f]{8}\.(json|parquet)")
"""Names of its files: no path leads out of the folder."""

_AT_ONCE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class SavedFile:
    file: str
    bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Manifest:
    """The content of `analysis.json`; `files` maps a name such as `summary.parquet` to its file."""

    format: str
    version: int
    written_by: str
    files: Mapping[str, SavedFile]


def write_folder(folder: Path, files: Mapping[str, Callable[[Path], object]]) -> None:
    """Write files (name -> function that writes at a path), then the manifest; an earlier save is replaced as a whole."""
    try:
        earlier = _earlier_files(folder)
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as after_failure:
            written = _write_files(folder, files, after_failure)
            with replacing(folder / MANIFEST, fsync=True) as draft:
                manifest = asdict(Manifest(FORMAT, VERSION, __version__, written))
                draft.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
            after_failure.pop_all()
    except (OSError, PolarsError) as err:
        raise OutputError(f"{folder}: the analysis cannot be saved ({err}); give another folder") from err
    for saved in earlier:
        _remove(folder / saved.file)


def _write_files(
    folder: Path, files: Mapping[str, Callable[[Path], object]], after_failure: ExitStack
) -> dict[str, SavedFile]:
    mark = secrets.token_hex(4)
    written = {}
    for name, write in files.items():
        stem, ending = name.split(".")
        path = folder / f"{stem}-{mark}.{ending}"
        after_failure.callback(_remove, path)
        with replacing(path, fsync=True) as draft:
            write(draft)
        written[name] = SavedFile(path.name, path.stat().st_size, _sha256(path))
    return written


def read_folder(folder: Path) -> dict[str, Path]:
    """Return name -> path of a save; a `TraceFormatError` if it is of another version, or one of its files was changed."""
    manifest = _read_manifest(folder)
    if manifest.version < VERSION:
        what = f"version {manifest.version} of a saved analysis; this program reads version {VERSION}: analyze the traces again"
        raise TraceFormatError(folder / MANIFEST, what)
    for saved in manifest.files.values():
        path = folder / saved.file
        try:
            intact = path.stat().st_size == saved.bytes and _sha256(path) == saved.sha256
        except OSError as err:
            raise TraceFormatError(path, f"a file of the saved analysis cannot be read ({err.strerror})") from err
        if not intact:
            raise TraceFormatError(path, "the file was changed after the analysis was saved; analyze again")
    return {name: folder / saved.file for name, saved in manifest.files.items()}


def _read_manifest(folder: Path) -> Manifest:
    path = folder / MANIFEST
    try:
        manifest = json.loads(read_regular(path))
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            raise TraceFormatError(path, "not the manifest of a saved analysis")
        if isinstance(manifest.get("version"), int) and manifest["version"] > VERSION:
            what = (
                f"version {manifest['version']} of a saved analysis; this program reads version {VERSION}: read it with the "
                "dds-trace that wrote it"
            )
            raise TraceFormatError(path, what)
        checked = from_json(Manifest, manifest)
    except OSError as err:
        what = f"no saved analysis here ({MANIFEST}: {err.strerror}); write one with Analysis.save"
        raise TraceFormatError(folder, what) from err
    except (ValueError, RecursionError) as err:
        raise TraceFormatError(path, f"the manifest of a saved analysis is damaged ({err})") from err
    for name, saved in checked.files.items():
        stem, _, ending = name.partition(".")
        if not (_FILE_NAME.fullmatch(saved.file) and re.sub("-[0-9a-f]{8}", "", saved.file) == f"{stem}.{ending}"):
            raise TraceFormatError(path, f"the manifest names {saved.file!r}, which no saved analysis has")
    return checked


def _earlier_files(folder: Path) -> tuple[SavedFile, ...]:
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return ()
    try:
        return tuple(_read_manifest(folder).files.values())
    except TraceFormatError as err:
        raise OutputExistsError(f"{folder}: has other files; give a folder of its own") from err


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink()


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with open_regular(path) as file:
        while piece := file.read(_AT_ONCE_BYTES):
            digest.update(piece)
    return digest.hexdigest()
