import pytest

from dds_trace.extensions.wire.messages import MULTICAST, Copy, SendLedger
from dds_trace.recorder.payloads.stamp import Stamp

A, B = 1, 2
S = 1_000_000_000


@pytest.fixture
def ledger():
    return SendLedger()


def whole(sequence, time_ns, destination=A):
    return Copy(sequence, 0, 1, destination, time_ns, 500)


def part(sequence, fragment, time_ns, count=1, destination=A):
    return Copy(sequence, fragment, count, destination, time_ns, 5000)


def test_a_sample_that_goes_to_two_destinations_is_not_repeated(ledger):
    assert not ledger.note("w", whole(1, 10, A))
    assert not ledger.note("w", whole(1, 11, B))
    assert ledger.note("w", whole(1, 30, A))


def test_what_went_to_all_is_repeated_when_it_goes_to_one(ledger):
    assert not ledger.note("w", whole(1, 10, MULTICAST))
    assert ledger.note("w", whole(1, 20, A))


def test_writers_number_their_samples_by_themselves(ledger):
    assert not ledger.note("w", whole(1, 10))
    assert not ledger.note("v", whole(1, 11))


def test_a_message_is_repeated_as_often_as_its_most_repeated_fragment(ledger):
    stamp = Stamp(9, 4, 0)
    assert not ledger.note("w", part(1, 1, 100), stamp)
    assert not ledger.note("w", part(1, 2, 110, count=2))
    assert ledger.note("w", part(1, 3, 400))
    assert ledger.note("w", part(1, 3, 700))
    assert ledger.note("w", part(1, 1, 800))
    ((key, sample),) = ledger.take(9)
    assert key == "w"
    assert sample.stamp == stamp
    assert sample.repeats == {3: 2, 1: 1}
    assert (sample.first_ns, sample.last_ns, sample.resent_after_ns) == (100, 800, 400 - 110)


def test_other_runs_are_left_when_one_is_taken(ledger):
    ledger.note("w", whole(1, 10), Stamp(1, 0, 0))
    ledger.note("w", whole(2, 20), Stamp(2, 0, 0))
    ledger.note("w", whole(3, 30))
    assert [sample.stamp.run_id for _, sample in ledger.take(2)] == [2]
    assert [sample.stamp.run_id for _, sample in ledger.take(1)] == [1]


def test_a_copy_of_a_forgotten_sample_is_a_late_repeat():
    ledger = SendLedger(remembered_ns=5 * S)
    ledger.note("w", whole(1, 0))
    ledger.note("w", whole(2, 4 * S))
    assert [sample.first_ns for _, sample in ledger.forget(6 * S)] == [0]
    assert ledger.note("w", whole(1, 6 * S))
    assert ledger.late_repeats == 1
    assert ledger.note("w", whole(2, 6 * S))
    assert ledger.late_repeats == 1


def test_a_repeated_sample_is_remembered_from_its_last_copy_on():
    ledger = SendLedger(remembered_ns=5 * S)
    ledger.note("w", whole(1, 0))
    ledger.note("w", whole(1, 4 * S))
    assert list(ledger.forget(6 * S)) == []


def test_of_too_many_copies_the_oldest_samples_go():
    ledger = SendLedger(remembered_copies=4)
    for sequence in range(3):
        ledger.note("w", part(sequence, 1, sequence, count=2))
    assert [sample.first_ns for _, sample in ledger.forget(3)] == [0]
    assert list(ledger.forget(3)) == []


def test_a_sample_that_went_out_whole_is_repeated_in_fragments(ledger):
    assert not ledger.note("w", whole(1, 10), Stamp(3, 0, 0))
    assert ledger.note("w", part(1, 1, 50))
    assert ledger.note("w", part(1, 2, 60))
    assert not ledger.note("w", part(1, 1, 70, destination=B))
    ((_, sample),) = ledger.take(3)
    assert sample.repeats == {1: 1, 2: 1}
    assert sample.resent_after_ns == 40


def test_a_sample_that_went_out_in_fragments_is_repeated_whole(ledger):
    assert not ledger.note("w", part(1, 1, 10))
    assert not ledger.note("w", part(1, 2, 20))
    assert ledger.note("w", whole(1, 50))
    assert not ledger.note("w", whole(1, 60, destination=B))
