# Recipes for people and CI. `just` lists them; each sets up what it needs.

set shell := ["bash", "-euo", "pipefail", "-c"]

python := env("DDS_TRACE_PYTHON", ">=3.10,<3.14")
venv := justfile_directory() / ".venv"
bin := venv / "bin"
lowest := justfile_directory() / ".venv-lowest"
kilted := justfile_directory() / ".venv-kilted"

# Everything below runs on this machine only.
export ROS_AUTOMATIC_DISCOVERY_RANGE := "LOCALHOST"
# Where byte code is forbidden (many containers), each of the hundreds of test processes would compile our modules again.
export PYTHONDONTWRITEBYTECODE := ""

_default:
    @just --list

# What measures and analyzes: the middlewares from pip, the analysis, and pip for more (0.8 GB; quick when nothing changed)
install:
    @test -x {{bin}}/python || uv venv --quiet --seed --python '{{python}}' {{venv}}
    @uv pip install --quiet --compile-bytecode --python {{bin}}/python -e '.[ros2,cyclonedds,zenoh,analyze]'

# Make .venv with all extras, those of tests, checks and pages too (1.9 GB), compiled as pip compiles them
setup:
    @test -x {{bin}}/python || uv venv --quiet --seed --python '{{python}}' {{venv}}
    @uv pip install --quiet --compile-bytecode --python {{bin}}/python -e '.[ros2,cyclonedds,zenoh,connext,analyze,cluster,test,check,docs]'

# The main job on this machine: every middleware from pip, same domain and domains 5 and 10 through the built-in bridges
demo: install
    @# 10: some recordings are missing, and the others have an answer.
    {{bin}}/dds-trace sweep plans/demo.toml --out out || test $? = 10
    {{bin}}/dds-trace analyze out/demo --report terminal --report html --open
    @echo 'All of it: source .venv/bin/activate && dds-trace analyze out/demo --all'

# Lint, format, types, import directions, size and words of the product, the Dockerfile
check: setup
    {{bin}}/ruff check .
    {{bin}}/ruff format --check .
    {{bin}}/mypy
    {{bin}}/lint-imports
    {{bin}}/python scripts/house.py
    @if test -x {{bin}}/hadolint; then {{bin}}/hadolint docker/Dockerfile; else echo 'no hadolint for this machine: docker/ is unchecked'; fi

# Fix what ruff can fix
fix: setup
    {{bin}}/ruff check --fix .
    {{bin}}/ruff format .

# The tests, of dear ones some cases; `just test-all` before a release or a change of what they hold
test *args: setup (_tests 'not slow and not thorough' args)

# All tests that end within minutes, every case of them: what CI runs
test-all *args: setup (_tests 'not slow' args)

# Three workers, which take neighbours, which share what they make; then six for real middlewares, whose tests wait, of files with such
_tests marks *args:
    @# In a fresh clone asserts are rewritten once, by two processes, and not by each worker.
    @ls tests/__pycache__/*-pytest-*.pyc >/dev/null 2>&1 || \
        { for rooms in 'tests/[a-q]*' 'tests/[r-z]*'; do {{bin}}/pytest --collect-only -qq $rooms >/dev/null & done; wait; }
    @# 5: nothing of what was asked for is of this kind.
    @failed=0; \
    {{bin}}/pytest -m '{{marks}} and not middleware' -n 3 --dist worksteal {{args}} || test $? = 5 || failed=1; \
    {{bin}}/pytest -m '{{marks}} and middleware' -n 6 --dist worksteal \
        {{ if args == "" { "$(grep -rl mark.middleware tests --include='test_*.py')" } else { args } }} || test $? = 5 || failed=1; \
    exit $failed

# Tests that take longer than a minute each (kills, long sweeps)
test-slow *args: setup
    {{bin}}/pytest -m 'slow and not ends' {{args}}

# Every role over every transport, with its peer stopped or gone, the link down, the machine busy: ends by itself, Ctrl-C, SIGTERM (root; half an hour)
ends *args: setup
    {{bin}}/pytest -n 6 tests/cli/record/test_every_end.py {{args}}

# The core with the oldest versions that pyproject.toml allows, in an environment of its own: traces, analysis, command line
test-lowest *args:
    @test -x {{lowest}}/bin/python || uv venv --quiet --python \
        "$(uv python find --no-python-downloads 3.10 2>/dev/null || echo '{{python}}')" {{lowest}}
    @uv pip compile --quiet --resolution lowest-direct --only-binary :all: --python {{lowest}}/bin/python --extra analyze \
        pyproject.toml --output-file {{lowest}}/requirements.txt >/dev/null
    @uv pip install --quiet --compile-bytecode --python {{lowest}}/bin/python -r {{lowest}}/requirements.txt \
        pytest pytest-timeout pytest-xdist hypothesis lz4 jsonschema
    @uv pip install --quiet --python {{lowest}}/bin/python --no-deps -e .
    {{lowest}}/bin/pytest -m 'not slow and not middleware and not browser' -n 2 -q {{args}} \
        tests/base tests/tracefile/reading tests/tracefile/mcapfile tests/analyzer/test_sample_traces.py tests/analyzer/groups \
        tests/extensions/exports tests/extensions/wire/test_analyze.py tests/analyzer/saving tests/cli/test_analyze_options.py tests/cli/test_help.py

# The tests on ROS 2 Kilted, in an environment of its own; pairs of both distributions with that of `just setup`
test-kilted *args:
    @test -x {{kilted}}/bin/python || uv venv --quiet --python '{{python}}' {{kilted}}
    @uv pip install --quiet --compile-bytecode --python {{kilted}}/bin/python -e '.[ros2-kilted,cyclonedds,zenoh,analyze,cluster,test]'
    DDS_TRACE_JAZZY={{bin}}/dds-record {{kilted}}/bin/pytest -m 'not slow' -n 3 --dist worksteal \
        {{ if args == "" { "tests" } else { args } }}

# Record sample_traces/ again
samples: setup
    DDS_TRACE_BIN={{bin}} sample_traces/record.sh

# Make the schema by which editors complete plans from the code
plan-schema: setup
    {{bin}}/python scripts/plan_schema.py

# Make the schemas of report.json and of comparisons from their records
schemas: setup
    {{bin}}/python scripts/report_schemas.py

# Build the real zenoh-bridge-dds and zenoh-bridge-ros2dds from crates (cargo, about twenty minutes)
install-zenoh-bridge:
    scripts/install-zenoh-bridge.sh

# Build the documentation into out/site/: opens from the folder, searches offline; a warning is an error
docs: setup
    {{bin}}/sphinx-build --quiet --fail-on-warning --keep-going -E -d out/site-cache docs out/site
    @echo "file://{{justfile_directory()}}/out/site/index.html"

# Take the pictures of docs/images/ again from the campaigns of docs/results/ (Chromium)
screenshots *names: setup
    {{bin}}/python scripts/screenshots.py {{names}}

# Take the picture of the studio again: a browser asks and waits for a real search of four minutes (Chromium)
studio-picture: setup
    {{bin}}/python scripts/studio_picture.py

# Run the commands of pages as printed, each page or kind of user (`boards`, ...: scripts/walk.py) in a fresh folder and home
walk *pages: setup
    for page in {{pages}}; do {{bin}}/python scripts/walk.py $page --log out/walks/$(basename $page .md).txt; done

# All benchmarks: ratios measured side by side in one run
bench: setup
    for script in benchmarks/bench_*.py; do {{bin}}/python $script; done

# The benchmarks at full size: 20 M events, 500 runs, 200 files (a quarter of an hour, 24 GB of memory)
bench-full: setup
    {{bin}}/python benchmarks/bench_sink.py
    {{bin}}/python benchmarks/bench_read.py --large
    {{bin}}/python benchmarks/bench_analyze.py --full --huge
    {{bin}}/python benchmarks/bench_analyze.py --growth

# The table of speed in benchmarks/performance.md, in turn with the checkout in DIR (half an hour; `--rounds 1`: a quarter)
bench-speed dir *args: setup
    {{bin}}/python benchmarks/bench_startup.py --against '{{dir}}' --csv benchmarks/speed.csv || true
    for script in bench_bag.py bench_analyze.py; do \
        {{bin}}/python benchmarks/$script --full --against '{{dir}}' --csv benchmarks/speed.csv {{args}} || true; done
    {{bin}}/python scripts/quoted.py

# A relay serves run after run for MINUTES: growth of its memory, open files and shared memory for 1000 runs
soak minutes="30" *args: setup
    nice -n 10 {{bin}}/python benchmarks/soak.py {{minutes}} {{args}}

# A billion synthetic events through dds-trace analyze, made and removed again (--events 100000000: a tenth; about 75 bytes of disk each)
bench-huge *args: setup
    {{bin}}/python benchmarks/huge.py {{args}}

# Dask workers on this machine against the same analysis in one process: wall time with 1, 2 and 4 (six minutes)
bench-cluster *args: setup
    {{bin}}/python benchmarks/cluster.py {{args}}

# The bars of the HTML page on four campaigns: bytes, heights, layout shift, answers, console, axe, Firefox (some minutes)
bench-report *args: setup
    uv pip install --quiet --python {{bin}}/python -e '.[browsers]'
    {{bin}}/python benchmarks/report_page.py {{args}}

# How far what `choose` learned is off at each campaign of docs/results/ by the others: the table of docs/results/learning.md (some minutes)
bench-learning: setup
    {{bin}}/python benchmarks/bench_learning.py --csv docs/results/learning.csv
    {{bin}}/python scripts/quoted.py

# How often what is said is true, by drawing: the tables of docs/results/coverage.md (--quick, names of tables)
coverage *args: setup
    {{bin}}/python benchmarks/coverage.py {{args}}

# How often comparisons of equal sides err, by drawing pairs from the recordings of a sweep (twenty repeats: docs/results/coverage.md)
real-aa *args: setup
    {{bin}}/python benchmarks/real_aa.py {{args}}

# Sweeps over all backends and bridges while things go wrong, for so many minutes, one line a round (root; tests/chaos/)
chaos minutes="30" *args: setup
    {{bin}}/python tests/chaos/chaos.py {{minutes}} {{args}}

# Fuzz what reads the bytes of strangers, guided by coverage (atheris), for so many seconds a target of tests/fuzz/fuzz.py
fuzz seconds="600" *targets="reader descriptions plan bag bag1 logs limits state ring watch peers strangers": setup
    uv pip install --quiet --python {{bin}}/python -e '.[fuzz]'
    export TMPDIR=$(mktemp -d -p /dev/shm dds-trace-fuzz-XXXXXX); trap 'rm -r "$TMPDIR"' EXIT; \
        finds=; for target in {{targets}}; do \
            {{bin}}/python tests/fuzz/fuzz.py $target "$(mktemp -d)" -max_total_time={{seconds}} || finds+=" $target"; \
        done; test -z "$finds" || { echo "finds:$finds"; exit 1; }

# Change one operator or number of the core at a time: tests are to notice 95 % (`stamps gates` some parts, `--share 0.1` a tenth of 3000)
mutants *args: setup
    {{bin}}/python tests/mutants/mutants.py {{args}}

# What a release takes: archives, each extra by itself on each Python that is here, wheels for aarch64, a bill of materials in out/dist/
release-check *args: setup
    {{bin}}/python scripts/check_release.py {{args}}

# Write table and page of docs/results/loopback/ again from the traces that it keeps
loopback-report: setup
    rm -rf out/kept && mkdir -p out/kept/loopback
    for traces in docs/results/loopback/*.tar.xz; do tar -xJf $traces -C out/kept/loopback; done
    {{bin}}/dds-trace analyze out/kept/loopback --report html --out out/kept/report
    cp out/kept/report/summary.parquet docs/results/loopback/
    {{bin}}/python scripts/stored_report.py keep out/kept/report/report.html docs/results/loopback/report.html.gz

# The paper's claims: a sweep of some 75 minutes (root, two processors, nothing else running) and the table of docs/results/study.md
paper-claims: setup
    {{bin}}/dds-trace sweep plans/paper-claims.toml --out runs
    {{bin}}/python scripts/quoted.py runs/paper-claims

# The claims' rows and table again from the traces that docs/results/study/claims/ keeps
kept-claims: setup
    rm -rf out/kept && mkdir -p out/kept/paper-claims
    for traces in docs/results/study/claims/*.tar.xz; do tar -xJf $traces -C out/kept/paper-claims; done
    {{bin}}/python scripts/quoted.py out/kept/paper-claims

# The table of benchmarks/performance.md: our nodes and programs that do nothing else, in turn (half an hour; `--backend zenoh` renews its rows)
bench-node *args: setup
    {{bin}}/python benchmarks/bench_node.py --rounds 3 --seconds 1.5 --csv benchmarks/node.csv {{args}} || true
    {{bin}}/python scripts/quoted.py

# Write the answers that README and the pages quote again from the traces of docs/results/ (a test fails where they differ)
readme: setup
    {{bin}}/python scripts/quoted.py

# What the newest releases of other programs read in our outputs: the table of docs/reference/readers.md (1.2 GB in a folder that it removes)
readers: setup
    {{bin}}/python scripts/readers.py

# Draw the stored reports of docs/results/ with their figures again: out/results/*.html
results: setup
    {{bin}}/python scripts/stored_report.py open docs/results/*/report.html.gz --out out/results
