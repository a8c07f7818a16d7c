import pytest
from wording import numbers

from dds_trace.base.errors import OptionError
from dds_trace.recorder.domains import (
    check_domain,
    domain_port_range,
    first_port,
    participants_in,
    participants_that_fit,
)
from dds_trace.recorder.kernel.counters import bound_udp_ports

HEAD = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"


@pytest.fixture
def proc(tmp_path):
    (tmp_path / "net").mkdir()
    (tmp_path / "sys/net/ipv4").mkdir(parents=True)
    (tmp_path / "sys/net/ipv4/ip_local_port_range").write_text("32768\t60999\n")

    def write(*ports, ipv6=()):
        for name, found, address in (("udp", ports, "0" * 8), ("udp6", ipv6, "0" * 32)):
            lines = [f"  {i}: {address}:{port:04X} {address}:0000 07\n" for i, port in enumerate(found)]
            (tmp_path / "net" / name).write_text(HEAD + "".join(lines))
        return tmp_path

    return write


def discovery_ports(domain_id, count):
    return [7400 + 250 * domain_id + 10 + 2 * number for number in range(count)]


@pytest.mark.parametrize("domain_id", [-1, 233, 1000])
def test_domain_ids_out_of_range_are_refused(proc, domain_id):
    with pytest.raises(OptionError, match=f"--domain {domain_id}: a DDS domain id must be between 0 and 232"):
        check_domain(domain_id, proc())


@pytest.mark.parametrize("domain_id", [0, 10, 100, 215, 220, 231])
def test_an_empty_domain_gives_no_warning(proc, domain_id):
    assert check_domain(domain_id, proc()) == []


def test_the_119th_neighbour_still_fits_and_the_120th_does_not(proc):
    assert check_domain(5, proc(*discovery_ports(5, 119))) == []
    with pytest.raises(OptionError, match=r"120 participants .* would use ports of domain 6"):
        check_domain(5, proc(*discovery_ports(5, 120)))


def test_the_last_domain_has_ports_for_fewer_participants(proc, sentences):
    assert (domain_port_range(232)[0], domain_port_range(232)[-1]) == (65_400, 65_535)
    assert [participants_that_fit(domain_id) for domain_id in (0, 231, 232)] == [120, 120, 63]
    assert participants_in(232, {65_410 + 2 * 62, 65_410 + 2 * 63}) == [62]
    (warning,) = check_domain(232, proc(*discovery_ports(232, 62)))
    with pytest.raises(OptionError) as refused:
        check_domain(232, proc(*discovery_ports(232, 63)))
    sentences(warning, str(refused.value))


def test_a_full_neighbour_domain_gives_a_warning(proc, sentences):
    (warning,) = check_domain(6, proc(*discovery_ports(5, 120)))
    sentences(warning)


def test_other_ports_are_no_participants(proc):
    found = bound_udp_ports(proc(7400 + 1250, 7400 + 1250 + 11, 53, ipv6=[7400 + 1250 + 14]))
    assert first_port(5) == 8650
    assert (domain_port_range(5)[0], domain_port_range(5)[-1]) == (8650, 8899)
    assert participants_in(5, found) == [2]


def test_ports_among_the_ephemeral_ones_give_a_warning(proc):
    assert check_domain(100, proc()) == []  # 32400 to 32649
    (warning,) = check_domain(101, proc())  # 32650 to 32899: its last ports only
    assert "(32650 to 32899)" in warning
    assert "(32768 to 60999)" in warning
    (first_ports,) = check_domain(214, proc())  # 60900 to 61149
    assert numbers(first_ports)[-3:] == [100, 215, 232]
    assert "up to 100 and from" in first_ports


def test_no_domain_is_proposed_where_the_kernel_gives_all_ports(proc):
    folder = proc()
    (folder / "sys/net/ipv4/ip_local_port_range").write_text("1024\t65535\n")
    assert "; " not in check_domain(10, folder)[0]


def test_a_system_without_proc_gives_no_warning(tmp_path):
    assert check_domain(150, tmp_path) == []
