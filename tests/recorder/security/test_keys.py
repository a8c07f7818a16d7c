import os
import stat
from email import message_from_bytes
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.recorder.choices import Security
from dds_trace.recorder.security import keys as keys_module
from dds_trace.recorder.security.keys import enclave, make_keys, opened_keys, public_hash, shared_keys

x509 = pytest.importorskip("cryptography.x509")

LEVELS = [level for level in Security if level is not Security.OFF]
KINDS = {
    Security.AUTHENTICATE: ("NONE", "NONE"),
    Security.SIGN: ("SIGN", "NONE"),
    Security.ENCRYPT_DATA: ("NONE", "ENCRYPT"),
    Security.ENCRYPT_RTPS: ("ENCRYPT", "NONE"),
}


def signed_text(path):
    text, signature = message_from_bytes(path.read_bytes()).get_payload()
    assert signature.get_content_type() == "application/x-pkcs7-signature"
    return ET.fromstring(text.get_payload().strip())


@pytest.mark.parametrize("level", LEVELS)
def test_both_sides_have_certificates_of_one_authority_and_the_documents_of_the_level(tmp_path, level):
    make_keys(tmp_path / "keys", level)
    for listens, name in ((False, "dds_trace_ping"), (True, "dds_trace_relay")):
        folder = enclave(str(tmp_path / "keys"), listens=listens)
        authority, own = (
            x509.load_pem_x509_certificate((folder / file).read_bytes())
            for file in ("identity_ca.cert.pem", "cert.pem")
        )
        own.verify_directly_issued_by(authority)
        assert own.subject.rfc4514_string() == f"CN={name}"
        governance = signed_text(folder / "governance.p7s")
        kinds = tuple(governance.find(f".//{kind}_protection_kind").text for kind in ("rtps", "data"))
        assert kinds == KINDS[level]
        assert governance.find(".//allow_unauthenticated_participants").text == "false"
        assert int(governance.find(".//max").text) <= 230  # Cyclone DDS reads no more
        assert signed_text(folder / "permissions.p7s").find(".//subject_name").text == f"CN={name}"


def test_nobody_else_reads_the_folder_and_the_authority_keeps_no_key(tmp_path):
    make_keys(tmp_path / "keys", Security.SIGN)
    assert stat.S_IMODE((tmp_path / "keys").stat().st_mode) == 0o700
    assert len(list((tmp_path / "keys").rglob("key.pem"))) == 2


def test_the_first_side_makes_the_keys_the_second_uses_them_and_they_go_with_the_first(tmp_path):
    folder = tmp_path / "keys"
    with opened_keys(Security.SIGN, str(folder)) as first:
        digest = public_hash(first)
        with opened_keys(Security.SIGN, str(folder)) as second:
            assert public_hash(second) == digest
        assert folder.exists()
    assert not folder.exists()
    assert list(tmp_path.iterdir()) == []


def test_the_hash_knows_no_key(tmp_path):
    make_keys(tmp_path / "keys", Security.SIGN)
    before = public_hash(str(tmp_path / "keys"))
    for key in (tmp_path / "keys").rglob("key.pem"):
        key.write_text("another")
    assert public_hash(str(tmp_path / "keys")) == before


def test_without_security_there_are_no_keys():
    with opened_keys(Security.OFF, None) as keys:
        assert keys is None


@pytest.mark.parametrize(
    "fault", ["none given", "open to others", "of another level", "no folder of ours", "a pipe", "a secret"]
)
def test_keys_that_cannot_be_used_are_one_line(tmp_path, monkeypatch, sentences, fault):
    monkeypatch.delenv(keys_module.VARIABLE, raising=False)
    folder = tmp_path / "keys"
    if fault == "no folder of ours":
        folder.mkdir(mode=0o700)
    else:
        make_keys(folder, Security.ENCRYPT_DATA if fault == "of another level" else Security.SIGN)
    if fault == "a pipe":
        (folder / keys_module.LEVEL_FILE).unlink()
        os.mkfifo(folder / keys_module.LEVEL_FILE)
    if fault == "a secret":
        (folder / keys_module.LEVEL_FILE).write_text("root:x\n")
    if fault == "open to others":
        folder.chmod(0o750)
    given = None if fault == "none given" else str(folder)
    with pytest.raises(OptionError) as raised, opened_keys(Security.SIGN, given):
        pass
    sentences(str(raised.value).replace(str(tmp_path), "FOLDER"))
    assert folder.exists()


def test_without_cryptography_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "cryptography.hazmat.primitives.serialization", None)
    with pytest.raises(BackendUnavailableError, match=r"dds-trace\[security\]"):
        make_keys(tmp_path / "keys", Security.SIGN)
    assert list(tmp_path.iterdir()) == []


def test_a_sweep_makes_keys_of_each_level_and_removes_them(monkeypatch, tmp_path):
    monkeypatch.setattr(keys_module.tempfile, "tempdir", str(tmp_path))
    stale = tmp_path / "dds-trace-keys-999999999-abc"
    stale.mkdir()
    with shared_keys(["off", "sign", "encrypt-rtps"]) as words:
        program, assignment = words
        name, _, folder = assignment.partition("=")
        monkeypatch.setenv(name, folder)
        assert program == "env"
        assert stat.S_IMODE(Path(folder).stat().st_mode) == 0o700
        for level in ("sign", "encrypt-rtps"):
            with opened_keys(Security(level), None) as keys:
                assert (Path(keys) / "level").read_text() == level
    assert list(tmp_path.iterdir()) == []
    with shared_keys(["off"]) as words:
        assert words == ()


def test_a_folder_that_is_not_there_is_made_or_refused_in_one_line(tmp_path):
    make_keys(tmp_path / "parent" / "keys", Security.SIGN)
    assert stat.S_IMODE((tmp_path / "parent" / "keys").stat().st_mode) == 0o700
    (tmp_path / "file").write_text("")
    with pytest.raises(OptionError, match=r"-o keys=.*file/keys: cannot be made"):
        make_keys(tmp_path / "file" / "keys", Security.SIGN)
