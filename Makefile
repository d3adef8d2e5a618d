# make demo        sets up what is missing, builds, and runs the four nodes on a simulated rig
# make test        sets up what is missing and passes the tests; ends with a table (test/tier)
# make long        tests that take minutes or need a quiet machine
# make lint        what CI lints: format, clippy, cores without middleware, docs
# make bench       the tracker beside other methods, images per second of each tracking method, the
#                  filter beside its bound on 200 runs
# make faults      every fault on real processes; prints the table of test/FAULTS.md
# make reproduce   the paper's figures and tables, and the report: OUT=folder
# make broad       recordings with real IMU samples (BROAD=its folder data_mat): test/BROAD.md
# make second-rig  the estimator on a second simulator (test/second_rig)
# make robustness  recordings that differ from their rig file: test/ROBUSTNESS.md
# make checks      recordings whose files are wrong, and what `volant check` names: test/CHECK.md
# make loop        a crane in MuJoCo in a closed loop with the nodes: OUT=folder; make loop-test
# make pages       generated pages (docs/src/parameters.md, figures.md, README.md)
# make deb         Debian packages of the release: target/debian; make deb-test: one in a new Debian
# make deb-arm64   the same for 64-bit ARM, cross-compiled; make arm64-test: tests in an emulator
# make tarball     statically linked programs for any amd64 Linux: target/tarball; make tarball-test
# make bridge      Eclipse's Zenoh bridge to other sites, from crates.io
# make book        HTML of the book
# make man         manual pages of all commands and shell completions: MAN=folder
# make fuzz        hostile bytes into every parser: FUZZ="-s SECONDS -r RUNS TARGET…"
# make audit       advisories and licenses of the dependencies
# make security    tests with DDS security (the middleware rebuilt with it)
# make kilted-test the tests against ROS 2 with its distribution Kilted
# make calibrate   volant calibrate camera (needs all of OpenCV); make calibrate-test: its tests
# make browser     a browser for the report's test

SHELL := /bin/bash
.DEFAULT_GOAL := build
.PHONY: setup build demo test long lint bench peers \
  loop loop-test reproduce faults broad robustness second-rig checks pages book man \
  fuzz audit kilted-test security calibrate calibrate-test browser clean-setup deb deb-test \
  deb-arm64 arm64-test tarball tarball-test bridge

ARCH_LIB := $(shell gcc -print-multiarch 2>/dev/null || echo x86_64-linux-gnu)
export OPENCV_LINK_PATHS := /usr/lib/$(ARCH_LIB)
export OPENCV_INCLUDE_PATHS := /usr/include/opencv4,/usr/include/$(ARCH_LIB)/opencv4

CARGO ?= cargo
VENV := .venv
export VOLANT_PYTHON := $(CURDIR)/$(VENV)/bin/python

# Set up once: Debian's packages (the smallest OpenCV set) and a Python environment for the peers
# in the tests.
setup: .setup/debian .setup/python

.setup/debian: launch_config/setup/debian-packages.txt launch_config/setup/install-debian-packages
	@mkdir -p .setup
	@launch_config/setup/install-debian-packages launch_config/setup/debian-packages.txt
	@touch $@

.setup/python: test/requirements.txt .setup/debian
	@echo "setting up a Python environment for the tests' peers in $(VENV)"
	@python3 -m venv $(VENV)
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check -r test/requirements.txt
	@touch $@

build: .setup/debian
	$(CARGO) build --release --workspace --bins

demo: build
	target/release/volant demo

# One build of everything: programs built apart from the tests would be compiled twice, because
# test features differ.
test: setup
	$(CARGO) build --release --workspace --all-targets
	test/tier full

# Tests that are too long, or need too quiet a machine, for every run; one at a time.
long: setup
	test/tier long

# A core knows no middleware, device or OpenCV: it must build without its default features.
# On one line: CI reads it.
CORES := ros_parameters rig_model rig_simulator node_kit marker_tracker imu_driver climber_driver pose_fusion rig_calibration

lint: .setup/debian
	$(CARGO) fmt --all --check
	@for core in $(CORES); do \
	  echo "core alone: $$core"; \
	  $(CARGO) check --quiet --release --no-default-features -p $$core || exit 1; \
	  if $(CARGO) tree --quiet --no-default-features --edges normal -p $$core | grep -E ' (ros2-client|rustdds|opencv|serialport|mcap) v'; then \
	    echo "$$core: its core depends on middleware or a device"; exit 1; fi; \
	done
	$(CARGO) clippy --release --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --quiet --release --workspace --no-deps

# The peers and the calibration need the large OpenCV, so they are workspaces of their own that
# `make test` never builds. They share a folder, because both build the same bindings, and their
# executables go beside `volant`, which finds them there.
.setup/debian-large: launch_config/setup/debian-packages-large.txt launch_config/setup/install-debian-packages .setup/debian
	@launch_config/setup/install-debian-packages $<
	@touch $@

LARGE := $(CURDIR)/target/large

peers: build .setup/debian-large
	cd test/peers && $(CARGO) build --release --target-dir $(LARGE)
	cp $(LARGE)/release/volant-peers target/release/

bench: peers
	target/release/volant-peers bench
	$(CARGO) test --release -p marker_tracker --test cost -- --include-ignored --nocapture
	VOLANT_RUNS=200 $(CARGO) test --release -p pose_fusion --test bounds -- --nocapture
	$(CARGO) test --release -p pose_fusion --test cost -- --include-ignored --nocapture

# Recordings that differ from their rig file: VOLANT_SHARED is the folder that has them under bags/.
robustness: build
	@[ -d "$(VOLANT_SHARED)/bags" ] || { echo "make robustness: set VOLANT_SHARED to the folder with bags/ in it"; exit 1; }
	@mkdir -p target/robustness
	@for bag in $(VOLANT_SHARED)/bags/*/; do name=$$(basename $$bag); \
	  target/release/volant replay $$bag/in.mcap --rig $$bag/rig.yaml --out target/robustness/$$name.mcap --overwrite > /dev/null || exit 1; \
	done
	target/release/volant robustness --bags $(VOLANT_SHARED)/bags --markers target/robustness --pairs --table test/ROBUSTNESS.md --overwrite

# The estimator on a second simulator, which shares no code with the first (test/second_rig).
second-rig: build .setup/python
	$(VENV)/bin/python test/second_rig $(if $(ONLY),--only "$(ONLY)")

# The estimator on recordings with real IMU samples (test/broad): BROAD=…/data_mat of
# https://github.com/dlaidig/broad.
BROAD_PYTHON := .setup/broad
.setup/broad.done: test/broad/requirements.txt .setup/debian
	@python3 -m venv $(BROAD_PYTHON)
	@$(BROAD_PYTHON)/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	@touch $@

broad: build .setup/broad.done
	@[ -n "$(BROAD)" ] || { echo "make broad: set BROAD to the folder data_mat of https://github.com/dlaidig/broad"; exit 1; }
	$(BROAD_PYTHON)/bin/python test/broad $(BROAD) --out target/broad \
	  --volant target/release/volant --table test/BROAD.md --overwrite

# Recordings whose files or messages are wrong in one thing, and what `volant check` names.
checks: build
	@[ -d "$(VOLANT_SHARED)/bags" ] || { echo "make checks: set VOLANT_SHARED to the folder with bags/ in it"; exit 1; }
	target/release/volant checks --bags $(VOLANT_SHARED)/bags --table test/CHECK.md --overwrite

# Generated pages: parameters from the declarations, figures from the files that tests and tools
# write.
pages: .setup/debian
	VOLANT_UPDATE_PAGES=1 $(CARGO) test --release -p volant --test pages

book:
	@command -v mdbook > /dev/null || { echo "make book: cargo install mdbook"; exit 1; }
	mdbook build docs

# For computers without a compiler: build on the oldest system and the architecture they have.
deb: build
	launch_config/setup/make-deb target/release target/debian

# The same for 64-bit ARM, cross-compiled. As root the first time, for Debian's arm64 libraries in
# target/arm64.
ARM64 := target/arm64
ARM64_BUILT := target/aarch64-unknown-linux-gnu/release
.setup/debian-arm64: launch_config/setup/debian-packages-arm64.txt .setup/debian
	@launch_config/setup/install-debian-packages $<
	@touch $@

deb-arm64: build .setup/debian-arm64
	launch_config/setup/build-arm64 $(ARM64) build --workspace --bins
	launch_config/setup/make-deb target/release target/debian $(ARM64_BUILT)

# Statically linked, for any amd64 Linux.
TARBALL := target/tarball
tarball: .setup/debian
	@launch_config/setup/install-debian-packages launch_config/setup/debian-packages-tarball.txt
	launch_config/setup/make-tarball $(TARBALL)

# The unpacked programs replay recordings as this build does, and are the nodes of a demo.
tarball-test: build tarball
	rm -rf $(TARBALL)/unpacked && mkdir $(TARBALL)/unpacked
	tar -C $(TARBALL)/unpacked --strip-components 1 -xzf \
	  $$(ls -t $(TARBALL)/volant-*.tar.gz | head -n 1)
	VOLANT_OTHER=$(CURDIR)/$(TARBALL)/unpacked/bin/volant VOLANT_OTHER_WITHIN=1e-4 \
	  $(CARGO) test --release --workspace --test other_build -- --ignored --nocapture
	VOLANT_BIN=$(TARBALL)/unpacked/bin target/release/volant demo --out $(TARBALL)/demo

# Eclipse's bridge to other sites, built from crates.io (docs/src/sites.md).
bridge: .setup/debian
	@launch_config/setup/install-debian-packages launch_config/setup/debian-packages-bridge.txt
	cd test/bridge && $(CARGO) build --release --locked --target-dir $(CURDIR)/target/bridge
	mkdir -p target/release && cp target/bridge/release/zenoh-bridge-ros2dds target/release/

# The tests of the cores in an emulator, and the recordings of VOLANT_SHARED replayed there and here.
arm64-test: deb-arm64
	launch_config/setup/build-arm64 $(ARM64) test --no-default-features --lib \
	  $(addprefix -p ,$(CORES))
	VOLANT_OTHER="qemu-aarch64-static -L $(CURDIR)/$(ARM64) $(CURDIR)/$(ARM64_BUILT)/volant" \
	  $(CARGO) test --release --workspace --test other_build -- --ignored --nocapture

# As root: about a minute and 400 MB in target/debian/root.
deb-test: deb
	@launch_config/setup/install-debian-packages launch_config/setup/debian-packages-deb.txt
	rm -rf target/debian/root
	launch_config/setup/try-deb $(CURDIR)/target/debian/root $$(ls -t target/debian/volant_*.deb | head -n 1)

# The manual pages of all commands, and the completions of bash, zsh and fish.
MAN ?= target/man
man: build
	target/release/volant manual --out $(MAN) --overwrite
	@for shell in bash zsh fish; do \
	  target/release/volant completions $$shell > $(MAN)/volant.$$shell || exit 1; \
	done

OUT ?= reproduced
reproduce: peers
	target/release/volant reproduce all --out $(OUT) --overwrite

calibrate: build .setup/debian-large
	cd volant/calibrate && $(CARGO) build --release --target-dir $(LARGE)
	cp $(LARGE)/release/volant-calibrate target/release/

calibrate-test: .setup/debian-large
	cd volant/calibrate && $(CARGO) test --release --target-dir $(LARGE)

# Only the test that renders the report needs it; without it that test is skipped.
browser: .setup/debian
	@launch_config/setup/install-debian-packages launch_config/setup/debian-packages-browser.txt

faults: setup build
	target/release/volant faults

# A crane in MuJoCo, the live nodes and examples/swing_control, in a Python environment of its own.
LOOP := .setup/loop
.setup/loop.done: test/loop/setup test/loop/requirements.txt $(wildcard msgs/msg/*.msg) \
  launch_config/setup/debian-packages-loop.txt .setup/debian
	@launch_config/setup/install-debian-packages launch_config/setup/debian-packages-loop.txt
	@echo "setting up the closed loop's Python environment in $(LOOP)"
	@test/loop/setup $(LOOP)
	@touch $@

loop: OUT = loop_run
loop: build .setup/loop.done
	$(LOOP)/bin/python test/loop --out $(OUT) $(if $(ONLY),--only $(ONLY) --without-gains) \
	  $(if $(TABLE),--table $(TABLE))

# The parts without nodes, then 4 s of one episode, which must end with a report; the figures are
# those of `make loop`.
loop-test: build .setup/loop.done
	$(LOOP)/bin/python -m unittest discover -s test/loop/tests
	$(LOOP)/bin/python test/loop --out target/loop-test --only swing --seconds 4 --without-gains \
	  || [ -f target/loop-test/report.html ]

fuzz: .setup/debian
	@test/fuzz/run $(FUZZ)

audit:
	@launch_config/setup/audit

# The tests with rclpy again, with that of Kilted.
.setup/kilted.done: test/requirements-kilted.txt .setup/debian
	@python3 -m venv .setup/kilted
	@.setup/kilted/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	@touch $@

kilted-test: .setup/kilted.done
	VOLANT_PYTHON=$(CURDIR)/.setup/kilted/bin/python $(CARGO) test --release -p node_kit --test ros2

# In a folder of its own: with the feature the middleware is another one.
security: .setup/debian
	@launch_config/setup/install-debian-packages launch_config/setup/debian-packages-security.txt
	$(CARGO) test --release -p node_kit -p volant --features node_kit/security,volant/security --test security --target-dir target/security -- --nocapture

clean-setup:
	rm -rf .setup $(VENV)
