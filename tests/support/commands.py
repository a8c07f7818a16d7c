"""`dds-analyze` called in this process."""

import pytest

from dds_trace.cli.analyze import main


def run_main(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code or 0
