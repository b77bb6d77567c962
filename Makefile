# make studio  sets everything up and opens the window on the demo scene
# make test    sets everything up and runs every check and test (starts its own Xvfb), JOBS=2 processes
# make quick   the tests to run while you work, 2 minutes at most: no window, training or placement
# make test-portable  tests whose results could hang on the processor, computed as another one does (3 minutes)
# make test-gl33  pictures and the window with OpenGL 3.3 and nothing beyond it
# make wheels  asks the package index for wheels of every dependency on every system
# make screenshots  takes the pictures of README and guide again (docs/images), and at two other sizes (build/screenshots)
# make demo    draws the demo scene again, which programs carry (assets/demo)
# make docs    sets everything up and builds the documentation into docs/_build
# make captures  places every kind of capture that people make, half an hour
# make fuzz SECONDS=600  damages files of every kind for that long, PROCESSES at a time (every core); every reader must survive
# make faults KILLS=100  kills each kind of program so often at random moments
# make cluster  runs twenty scenes on a dask cluster whose workers are killed and run out of memory
# make peers  installs the programs of others that tests compare with, where there is npm
# make bench-peers  times OpenSplat (built here) and splat-transform next to ours, hours of one processor
# make browser  installs the Chromium that tests of web pages drive, where there is apt
# make test-browsers  web pages in Chromium and, on demand, in Firefox
# make soak MINUTES=10 COMMANDS=20000  random commands of the session, then random events in a window; nothing may be lost
# make app     a folder dist/gaga-studio that starts on a Linux without Python (a few minutes)
# make app-models  torch and what reads models and makes bodies, as the folder dist/models to put into it
# make test-app    starts that folder in a bare Debian root (as root, with debootstrap and Xvfb)
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
# Whatever the environment says: tests start the program hundreds of times, and it was compiled each time.
export PYTHONDONTWRITEBYTECODE :=
PEERS := @playcanvas/splat-transform@3.7.0 gltf-validator@2.0.0-dev.3.10

.PHONY: bench-peers wheels test-gl33 app app-models test-app test-browsers test-portable studio test quick peers browser kernels fuzz soak faults cluster captures check demo style types imports pages docs setup bench screenshots clean

studio:
	@.ci/has-display
	@.ci/system-libraries window
	@$(MAKE) --quiet --no-print-directory $(STAMP)
	@$(BIN)/gaga-studio --demo

# What needs one processor each runs at once. Kernels first, or each process of the tests compiles them.
# A file stays in one process: what opens a window comes before what draws without a display.
# A test that hangs ends its process after ten minutes, with what each thread was doing, and counts as failed.
test: setup
	@$(MAKE) --quiet --no-print-directory -j2 --output-sync types kernels pages style imports peers browser
	@$(BIN)/python -m pytest -q -n $(or $(JOBS),2) --dist loadfile --no-loadscope-reorder \
	-o faulthandler_timeout=600 -o faulthandler_exit_on_timeout=true --max-worker-restart 1

quick: setup
	@$(MAKE) --quiet --no-print-directory kernels
	@$(BIN)/python -m pytest -q -m quick -n $(or $(JOBS),2)

# As on a processor without AVX and FMA, with one thread: vectors, sums and eigenvectors round
# otherwise there, and no result that is promised may hang on that.
PORTABLE := $(addprefix tests/core/,grouping identity segmentation/test_regions.py scene/edits \
	raster/test_operators.py raster/test_gradients.py raster/test_vote_slots.py)
test-portable: setup
	@NPY_DISABLE_CPU_FEATURES="X86_V3 X86_V4 AVX512_ICL AVX512_SPR" OPENBLAS_CORETYPE=Haswell NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES= GAGA_THREADS=1 \
	$(BIN)/python -m pytest -q -n $(or $(JOBS),2) --dist loadfile $(PORTABLE)

# What drivers of 2010 have, in Mesa: a call beyond it fails, and so does the test.
test-gl33: setup
	@MESA_GL_VERSION_OVERRIDE=3.3 MESA_GLSL_VERSION_OVERRIDE=330 $(BIN)/python -m pytest -q -n $(or $(JOBS),2) \
	--dist loadfile tests/gpu tests/app/window/test_picture.py tests/app/window/test_window.py tests/app/window/test_start.py

wheels: setup
	@$(BIN)/python -m tests.wheels

peers: .peers/.ready

.peers/.ready: Makefile
	@mkdir -p .peers
	@command -v npm >/dev/null || { echo "no npm: tests against other programs are skipped"; exit 0; }; \
	npm install --silent --no-audit --no-fund --ignore-scripts --prefix .peers $(PEERS) \
	&& touch $@ || echo "npm failed: tests against other programs are skipped"

# OpenSplat on the CPU, where there is a compiler: with Debian's libopencv-dev, nlohmann-json3-dev, libcxxopts-dev, libnanoflann-dev.
bench-peers: setup peers
	@[ -x .peers/OpenSplat/build/opensplat ] || { command -v cmake >/dev/null && command -v c++ >/dev/null \
	&& { [ -d .peers/OpenSplat ] || git clone --quiet --depth 1 https://github.com/pierotofy/OpenSplat .peers/OpenSplat; } \
	&& cmake -S .peers/OpenSplat -B .peers/OpenSplat/build -DGPU_RUNTIME=CPU -DFETCHCONTENT_TRY_FIND_PACKAGE_MODE=ALWAYS \
	-DCMAKE_PREFIX_PATH=$$($(BIN)/python -c "import torch; print(torch.utils.cmake_prefix_path)") \
	&& cmake --build .peers/OpenSplat/build --target opensplat; } || echo "OpenSplat is not built: it is left out"
	@$(BIN)/python -m tests.bench peers --record
	@$(BIN)/python -m tests.bench --tables

# Debian's Chromium, which tests of web pages drive.
browser:
	@.ci/system-libraries browser || echo "no chromium: tests of web pages are skipped"

test-browsers: setup browser
	@.ci/system-libraries firefox || echo "no firefox: its test is skipped"
	@GAGA_TEST_FIREFOX=1 $(BIN)/python -m pytest -q tests/web

captures: setup
	@GAGA_LONG_CAPTURES=1 $(BIN)/python -m pytest -q tests/captures

fuzz: setup
	@$(BIN)/python -m tests.fuzz $(or $(SECONDS),600) $(if $(PROCESSES),--processes $(PROCESSES)) $(if $(SEEDS),--seeds $(SEEDS))

soak: setup
	@$(BIN)/python -m tests.soak.walk $(or $(COMMANDS),20000)
	@$(BIN)/python -m tests.soak.window $(or $(MINUTES),10)

faults: setup
	@GAGA_TEST_KILLS=$(or $(KILLS),100) $(BIN)/python -m pytest -q tests/faults tests/core/scene/test_two_writers.py

cluster: setup
	@$(BIN)/python -m tests.cluster

check: setup
	@$(MAKE) --quiet --no-print-directory -j2 --output-sync types pages style imports

style:
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check -q .

types:
	@$(BIN)/mypy

imports:
	@$(BIN)/lint-imports

pages:
	@$(BIN)/sphinx-build -q -W --keep-going docs docs/_build

kernels:
	@$(BIN)/python -c "from gaga_core.kernels import is_compiled; from gaga_core.pipeline.compile_kernels import warm_up_stage; is_compiled() or list(warm_up_stage())"

demo: setup
	@$(BIN)/python -m tools.demo.make

docs: setup
	@$(BIN)/sphinx-build -W --keep-going docs docs/_build
	@echo "Open docs/_build/index.html"

setup:
	@.ci/system-libraries tests
	@$(MAKE) --quiet --no-print-directory $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --upgrade pip
	@$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev,docs]'
	@touch $(STAMP)

app: setup
	@$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[app]'
	@$(BIN)/pyinstaller --noconfirm --log-level WARN --distpath dist --workpath build/app app/bundle/gaga-studio.spec
	@find dist/gaga-studio/_internal \( -name '*.so' -o -name '*.so.*' \) -type f -not -path '*.libs/*' -not -name '*pool.*' -exec strip --strip-unneeded {} +  # patchelf's do not load then
	@mkdir -p dist/gaga-studio/desktop
	@cp app/bundle/install.sh app/bundle/gaga LICENSE dist/gaga-studio/
	@cp app/bundle/gaga-studio.desktop app/bundle/gaga-studio.svg app/bundle/gaga-studio.xml dist/gaga-studio/desktop/
	@du -sh dist/gaga-studio

app-models: setup
	@rm -rf dist/models
	@$(BIN)/python -m pip install --quiet -c constraints.txt --target dist/models torch transformers huggingface_hub httpx2 usd-core coacd manifold3d mujoco-core
	@rm -rf dist/models/numpy dist/models/numpy.libs dist/models/numpy-*  # the program has all of it
	@du -sh dist/models

test-app:
	@test -x dist/gaga-studio/gaga-studio || $(MAKE) app
	@GAGA_TEST_APP=dist/gaga-studio $(BIN)/python -m pytest -q tests/test_app_folder.py

bench: setup
	@$(BIN)/python -m tests.bench

screenshots: setup
	@$(BIN)/python -m tests.screenshots --sizes build/screenshots

clean:
	@rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache build dist docs/_build docs/api .peers
