# make, make <scene>, make <scene>/<stage>, make help.  The stages and their files: pipeline.yaml.
# lib/planning/plan.py walks back from a scene's goals and writes build/<scene>/plan.mk, plain Make.  This file runs it.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
MAKEFLAGS += --no-builtin-rules --no-print-directory
.SUFFIXES:
.DELETE_ON_ERROR:
ifeq ($(filter grouped-target,$(.FEATURES)),)
$(error GNU Make 4.3 or newer is needed, this is $(MAKE_VERSION))
endif

DATA ?= data
BUILD ?= build
PYTHON := .venv/bin/python
PYTHON3 ?= python3
ONLY ?= *
INSTALL := -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r

# What is told is text, whatever signs it holds: Make would run a $(shell ...) in it, and the shell a `...`. So each variable
# is taken as it stands, and reaches the programs through the environment. MAKEOVERRIDES: the Make of a scene gets no others
TOLD := DATA BUILD SCENE NAME MODEL PHOTO CAMERA IMAGE PICKS MEGAPIXELS ONLY PYTHON3 V
$(foreach v,$(filter-out MAKEOVERRIDES MAKEFLAGS,$(.VARIABLES)),$(if $(findstring command line,$(origin $v)),$(eval override $v := $$(value $v))))
$(foreach v,$(TOLD),$(eval override $v := $$(value $v)))
export $(TOLD)
MAKEOVERRIDES :=
quoted = '$(subst ','\'',$1)'

NO_TARGET = is not a scene or a target: a folder of $(DATA)/ whose name has letters, digits, _ and - alone
# What no rule makes: a name with blanks, which Make takes for two, or one with other signs
.DEFAULT:
	@printf '%s\n' $(call quoted,$@: $(NO_TARGET)) >&2; exit 2

TARGETS := all plan new-scene check lint test test-slow verify verify-long bench scenes docs doctor help clean setup demo
GOALS := $(or $(MAKECMDGOALS),demo)
# Make takes ':' in a name for a rule, and blanks for two names
define scenes
cd -- $(call quoted,$(DATA)) 2>/dev/null && ls -d */scene.yaml 2>/dev/null | while IFS= read -r path; do name=$${path%/scene.yaml}; \
  case $$name in *[!A-Za-z0-9_-]*) printf '%s\n' $(call quoted,$(DATA)/)"$$name: warning: left out: letters, digits, _ and - alone name a scene" >&2 ;; \
  *) echo "$$name" ;; esac; done
endef
SCENES := $(shell $(scenes))

# Names that are no more than letters, digits, _ - and /: nothing else may become a part of a rule
LETTERS := a b c d e f g h i j k l m n o p q r s t u v w x y z A B C D E F G H I J K L M N O P Q R S T U V W X Y Z 0 1 2 3 4 5 6 7 8 9 _ - . /
other = $(strip $(eval left := $$1)$(foreach c,$(LETTERS),$(eval left := $$(subst $c,,$$(left))))$(left))
plain = $(foreach word,$1,$(if $(call other,$(word)),,$(word)))

# What is asked for: scenes and stages of scenes; those of one scene are planned and run together.
WISHES := $(sort $(call plain,$(filter-out $(TARGETS) .venv%,$(GOALS))) $(if $(filter demo,$(GOALS)),office-stereo) \
  $(if $(filter all,$(GOALS)),$(SCENES)))
NAMES := $(sort $(foreach wish,$(WISHES),$(firstword $(subst /, ,$(wish)))))

.PHONY: $(TARGETS) $(WISHES) $(NAMES:%=run-%)
demo: run-office-stereo
all: $(SCENES:%=run-%)

# Another make of the same scene is waited for: they would write the same files.  The system ends the lock with its owner.
define alone
folder="$$$$BUILD"/$(1); if [ -d "$$$$folder" ] && command -v flock >/dev/null; then exec 9<"$$$$folder"; \
  flock -n 9 || { echo "$$$$folder: another make is at work: waiting for it" >&2; flock 9; }; fi
endef

define scene
$(filter-out run-$(1),$(filter $(1) $(1)/%,$(WISHES))): run-$(1) ; @:
run-$(1): setup
	+@[ -e .venv/ready ] || { echo '# the plan of $(1) is known once .venv is there'; exit 0; }; \
	$(call alone,$(1)); \
	$$(PYTHON) -m lib.planning.plan --data="$$$$DATA" --build="$$$$BUILD" --python $$(PYTHON) \
	  $(filter $(1) $(1)/%,$(WISHES)); \
	$(call alone,$(1)); \
	$$(MAKE) -f "$$$$BUILD"/$(1)/plan.mk
endef
$(foreach name,$(NAMES),$(eval $(call scene,$(name))))

plan: setup
	@read -ra names <<< "$$SCENE" || true; \
	$(PYTHON) -m lib.planning.plan --show --data="$$DATA" --build="$$BUILD" -- "$${names[@]}"

# A folder from a photograph, a model and perhaps a camera of another program
new-scene: setup
	@$(PYTHON) stages/new_scene.py --data="$$DATA" --name="$$NAME" --model="$$MODEL" --photo="$$PHOTO" \
	  --camera="$$CAMERA" --image="$$IMAGE" --picks="$$PICKS" --megapixels="$$MEGAPIXELS"

# The loop while one works; all that must pass; what takes minutes each.  Tests run side by side, one on each core.
# Thousands of processes start: each would compile lib/ anew, half a CPU second, where bytecode may not be written.
TESTS := PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(PYTHON) -m pytest -n auto --dist worksteal -p tests.helpers.costs

check: lint
	NUMBA_NUM_THREADS=1 $(TESTS) -m 'not scene and not outside and not slow'

test: lint
	NUMBA_NUM_THREADS=$${NUMBA_NUM_THREADS:-2} $(TESTS) -m 'not slow'

test-slow: setup
	NUMBA_NUM_THREADS=$${NUMBA_NUM_THREADS:-2} $(TESTS) -m slow

# Laws and closed forms, as a table and a page; which hold is the exit status.  Some seconds of kernels, then 90 at most
verify: setup
	@$(PYTHON) -m tests.verify

verify-long: setup
	@$(PYTHON) -m tests.verify --long

lint: setup
	@$(PYTHON) -m ruff check --quiet
	@$(PYTHON) -m ruff format --check --quiet

bench: setup .venv/ready-bench
	$(PYTHON) -m tests.bench

.venv/ready-bench: requirements-bench.lock | setup
	@$(PYTHON) $(INSTALL) $< \
	  || echo "pottslab: not installed; its measured energies stand for it" >&2
	@touch $@

doctor: setup
	@$(PYTHON) -m lib.planning.doctor

# Synthetic scenes are committed; only to make them again is Mitsuba needed, which has an environment of its own.
# The command line of each stands in its origin.md.  ONLY=office for one of them.
scenes: .venv-scenes/ready
	@sed -n 's,^ *\(stages/synthesise.py .*\),\1,p' data/$$ONLY/origin.md | while read -r words; do \
	  echo "$$words"; .venv-scenes/bin/python $$words; done

# The pages as a site; a link or a citation in the code that leads nowhere ends it.  The sources are copied, since links go
# from page to page as here
docs: .venv-docs/ready | setup
	@rm -rf build/docs-src && mkdir -p build/docs-src
	@$(PYTHON) -m pytest -q -n 0 tests/test_docs.py -k 'no_link or no_citation' > build/docs.log || { grep '^E' build/docs.log >&2; exit 1; }
	@git ls-files -z -- '*.md' 'docs/*' pipeline.yaml Containerfile LICENSE CITATION.cff .ci/run | xargs -0 cp --parents -t build/docs-src
	@.venv-docs/bin/mkdocs build --strict > build/docs.log 2>&1 || { grep -E '^(WARNING|ERROR)' build/docs.log >&2; exit 1; }
	@echo "file://$(CURDIR)/build/docs/index.html"

# What anasyn made, and nothing else that lies there
clean:
	@"$$PYTHON3" -m lib.planning.clean "$$BUILD"

help:
	@printf '%s\n' \
	  'make                    set up, and run the demo scene: office-stereo' \
	  "make <scene>            one scene of $$DATA/, up to its goals" \
	  'make <scene>/<stage>    one scene, up to and including one stage' \
	  'make <scene>/check      a second: the model over the photograph, and what is doubtful, before a long run' \
	  'make all                every scene;  make -k all goes on after a failure' \
	  'make new-scene NAME=x MODEL=f PHOTO=f [CAMERA=f] [PICKS=f]    a scene from your files: OBJ, GLB; COLMAP, fSpy' \
	  'make plan               the stages of every scene, on a screen;  SCENE=<scene>: of one, what is left out, and why' \
	  "make V=1 <scene>        shows the command lines, which also lie in $$BUILD/<scene>/commands" \
	  'make check              lint and every quick test: two minutes' \
	  'make test               all tests but the slow ones;  make test-slow: those' \
	  'make verify             laws and closed forms, towards stiff cases: a table and a page;  make verify-long: all of them' \
	  'make bench              error against run time, as CSV and plots' \
	  'make doctor             what is installed, and what to do about what is not' \
	  'make scenes             make the synthetic scenes again (installs Mitsuba in .venv-scenes)' \
	  'make docs               README and docs/ as a site in build/docs, by MkDocs (installed in .venv-docs)' \
	  "make clean              remove the outputs of scenes in $$BUILD/, and nothing else" \
	  'DATA=folder BUILD=folder    other scenes, other outputs;  -n says what would run;  -j<n> runs side by side' \
	  $(call quoted,scenes: $(SCENES)) \
	  "stages: $$(sed -n 's/^\([a-z][a-z0-9_]*\):.*/\1/p' pipeline.yaml | tr '\n' ' ')"

# ---- setting up: Debian's packages if this is Debian and we may, then .venv from the lock file ----
DEBIAN := python3 python3-venv mrcal python3-mrcal libegl1 libgl1 libgl1-mesa-dri libgomp1 libx11-6 libusb-1.0-0

setup: .venv/ready

.venv/ready: requirements.lock
	@missing=; \
	if command -v dpkg-query >/dev/null; then \
	  for p in $(DEBIAN); do \
	    dpkg-query -W -f '$${Status}' $$p 2>/dev/null | grep -q 'ok installed' || missing="$$missing $$p"; \
	  done; \
	fi; \
	if [ -n "$$missing" ]; then \
	  sudo=; [ "$$(id -u)" = 0 ] || sudo='sudo -n'; \
	  echo "Debian packages:$$missing"; \
	  if [ -z "$$sudo" ] || sudo -n true 2>/dev/null; then \
	    $$sudo apt-get update -qq || true; \
	    $$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$missing >/dev/null \
	      || echo "apt-get install$$missing: failed; going on without" >&2; \
	  else echo "not root, and no sudo: going on without; apt-get install$$missing" >&2; fi; \
	fi
	@echo 'Python packages, from requirements.lock into .venv'
	@"$$PYTHON3" -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else \
	  f"Python 3.11 or newer is needed, this is {sys.version.split()[0]} (PYTHON3=... names another)")'
	"$$PYTHON3" -m venv .venv
	$(PYTHON) $(INSTALL) requirements.lock
	@touch $@

.venv-exports/ready: requirements-exports.lock
	"$$PYTHON3" -m venv .venv-exports
	.venv-exports/bin/python $(INSTALL) requirements-exports.lock
	@touch $@

.venv-docs/ready: requirements-docs.lock
	"$$PYTHON3" -m venv .venv-docs
	.venv-docs/bin/python $(INSTALL) requirements-docs.lock
	@touch $@

.venv-scenes/ready: requirements-scenes.lock
	"$$PYTHON3" -m venv .venv-scenes
	.venv-scenes/bin/python $(INSTALL) requirements-scenes.lock
	@touch $@
