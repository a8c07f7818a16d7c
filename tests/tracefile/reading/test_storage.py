from __future__ import annotations

import base64
import zlib

import pytest

from dds_trace.base.errors import MissingEventsError, TraceFormatError
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.reading.storage import find_traces


def test_files_and_bags_are_found_below_and_sorted(tmp_path):
    for name in ("b.mcap", "a/z.mcap", "bag/bag_0.mcap", "bag/metadata.yaml", "a/old/old_0.db3", "a/old/metadata.yaml"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "b.mcap.ring").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "metadata.yaml").write_text("")
    found = [str(path.relative_to(tmp_path)) for path in find_traces(tmp_path)]
    assert found == ["a/old", "a/z.mcap", "b.mcap", "bag"]


def test_skipped_folders_and_files_are_left_out(tmp_path):
    for name in ("keep.mcap", "drop.mcap", "analysis/own.mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "again.mcap").symlink_to(tmp_path / "drop.mcap")
    (tmp_path / "by_a_link").symlink_to(tmp_path, target_is_directory=True)
    skip = [tmp_path / "analysis", tmp_path / "x" / ".." / "drop.mcap"]
    assert find_traces(tmp_path / "by_a_link", skip=skip) == [tmp_path / "by_a_link" / "keep.mcap"]
    assert find_traces(tmp_path, skip=skip) == [tmp_path / "keep.mcap"]


def test_a_trace_is_found_in_itself(tmp_path):
    (tmp_path / "x.mcap").write_text("")
    assert find_traces(tmp_path / "x.mcap") == [tmp_path / "x.mcap"]
    (tmp_path / "metadata.yaml").write_text("")
    assert find_traces(tmp_path) == [tmp_path]


def test_no_folder_is_an_error(tmp_path):
    with pytest.raises(MissingEventsError, match="nowhere"):
        find_traces(tmp_path / "nowhere")


DATABASES = {
    # SQLite meets an absurd size in the schema and Python's sqlite3 says MemoryError.
    "memory": (
        "c-rmN&5qJg6bJBg`bmNEX)>7w@$M8e5yyD}fi#ne_=Rj{MGCE?nJEz3Ow=7u;UgHIK_9_KF)rP>&|41G%T3G;i7rMxq4(c5?"
        "eF&X()RhYL6nB<#bOovDLVlT5a9u10HE{5f}f@F#Spd;)TP7SDZ1Iocn9zeZ?0`!X!b#?h3j_ePcFkaOcH+<Cg1*K<(=sLq1"
        "PRGY}D-yJeKcex1)faJsx?d-jF>Vo;~Ug&)Gxo{D`HCWi%Z}0bh&w(WxIVk67TRKI;vh^x8AD4-OCWk!%i5sMU5lqJ6*aX70"
        "x!@8Z>xw@J8){LARIpGJ%MnEp=fY~m3=0{{K5YhL%!gj=W0P7oyHbmdROPH_BVeH<sVq{ExeDBJX|!g)FkR_5lx|B{_<;a6J"
        "uhim)7wEzB*nw9KZVY{2r-UR%BFYyFE!#fE0W?p^U0teTImED>AYhp>Ms=h^tDI%tnO2j0@5D`O4C1Mbwi-<0z6443KL`0KP"
        "RXvR(&U$AwxW`v}V<0yQyT-mn^WOq|k5_mPKEYd<@XhT=D>PD9?7@{%dAnRf$|6#hQi+raDTzo)N+nVvq$naqDV0c(5JyBDD"
        "V2yrNI^sjQYw)GA-0Ivu-_ZZ-8{z=n*ZbN{QuVK-=NEEikI1xQi(JPX^2QeN+r@Dq%I<LDV0c_keZ0pq*Nj`LaHKCl~RdR38"
        "{!kMM_nD2RK^ZNd"
    ),
    # A damaged page gives a topic without a number.
    "null id": (
        "c-rmN%Wl&^6b9gPe2sIzAXQyN%npJoqQVQ1L{?Qb+)OrEMQ&^&i#mzoQ3dSs6g&dr8Q>9k6vUDZ8^$>pCc|Q=#HON0$^0J6{"
        ">ILcofpr?36I&!)g}!&dk6*~!Xw52z!YBxewQJ>mNZAumkIahSj$hwdw}o6aBb_A;U09mxb5-q{31@{EDINLR-`!!{K3R$lf"
        "iK8vtlp1n?&sN$;3bL1NJO9eLM)J?987YF}_+S^H~y!twbEn!*qSbqL7DdIDR_pEzmtUJS-O59h}i<>@7t5{#fR0!2Dn;mRW"
        "{rES7k)7GoA~lJFvV8}ekeoKeSnd2bLugZSLkHLnL~!<~~(KZ>#$--PqH&yRm?&(ds>^~KPi<Wv7LUh;Xgv3JkrxBPSmzthG"
        "|{Rd^&^VhkXKmRV=2K<Dt@fg0s2Z+S9sFCY{hg-|Z-}c1|-%(OmBZm-MMr<Xuh)swkBbJg{#3IC$5mQMmViID=h@qsehK4}A"
        "?cUws75-Rv1`4CJZ(Oyg|6Rb3cq#h-1>VECnEt%eI^AhaUZJL>_UEb*Qk9Xal3JunNJT~}N@|e`A!QjUE2%}wgm^OIDXB#~L"
        "P|1HQc{bQ2ytb^Rq}88?}(P~_5YvN=oVdON50ICl3JugNLxnQN@|fdAuSncDXB$TgfwNOsiYQZ64H>7hLT#OK}cOj>PqVB2S"
        "I>=tp"
    ),
}


@pytest.mark.parametrize("packed", DATABASES.values(), ids=list(DATABASES))
def test_a_damaged_database_is_a_trace_or_an_error_that_names_it(tmp_path, packed):
    (tmp_path / "metadata.yaml").write_text("")
    path = tmp_path / "bag_0.db3"
    path.write_bytes(zlib.decompress(base64.b85decode(packed)))
    try:
        trace = read_trace(tmp_path)
    except TraceFormatError as err:
        assert str(tmp_path) in str(err)  # noqa: PT017 - one or the other is right
    else:
        assert trace.event_count <= 20
