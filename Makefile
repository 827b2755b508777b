# The ways into this project; each target sets up what it needs. `make help` lists them.
#
# Two cargo profiles, each with its own build of the dependencies (about two minutes of C++ on two cores):
#   dev      `lint` and `test`: debug assertions and overflow checks are on, and the profile in Cargo.toml optimises in full
#            what tests that train spend their time in. Both targets share one build of libtorch's shim.
#   release  `build`, `demo` and `bench`: what is measured and used.
CARGO ?= cargo
# What is built in besides: `make FEATURES=` leaves libsumo out, and with it Python.
FEATURES ?= libsumo
# rustup's folder, in case no new shell was opened since.
export PATH := $(PATH):$(HOME)/.cargo/bin

# One cargo at a time, whatever -j says: they would only wait for each other's lock.
.NOTPARALLEL:
.PHONY: help bootstrap build demo test python matrix lint check-client bench

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST)

bootstrap: ## install what is missing: SUMO, build tools, Python headers, libtorch
	@scripts/bootstrap

build: bootstrap ## build target/release/iwol
	$(CARGO) build --locked --release --features "$(FEATURES)"

demo: build ## train vehicles to cross an intersection, and compare them with SUMO's own driver
	scripts/demo

test: ## run every test: unit, integration (against the real SUMO) and documentation
	@scripts/bootstrap --tests
	$(CARGO) test --locked --features "$(FEATURES) mpi"

python: ## build the Python package, install it into an empty virtual environment, and run its tests
	@scripts/bootstrap --client --python
	CARGO_TARGET_DIR=target/python/target $(CARGO) clippy --locked -p iwol-sumo-python -- -D warnings
	scripts/python-package

# Releases on the Python package index are fetched once: scripts/matrix says more.
SUMOS ?= debian 1.20.0 newest

matrix: ## compare trainings, the TraCI client and libsumo on several releases of SUMO
	@scripts/bootstrap
	$(CARGO) build --locked --profile test --features "$(FEATURES)" --bin iwol
	scripts/matrix $(SUMOS)

lint: bootstrap check-client ## check formatting, clippy's lints and the documentation; a warning is an error
	$(CARGO) fmt --all --check
	$(CARGO) clippy --locked --all-targets --features "$(FEATURES)" -- -D warnings
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --locked --no-deps --features "$(FEATURES)"

check-client: ## build library and program without libtorch (without the feature `learn`), and check them
	$(CARGO) build --locked --no-default-features
	$(CARGO) clippy --locked --no-default-features -- -D warnings
	$(CARGO) clippy --locked --no-default-features --features "$(FEATURES)" -- -D warnings

bench: bootstrap ## measure speed with criterion
	$(CARGO) bench --locked --features "$(FEATURES)"
