# fascicle with the versions that its tests ran with:
#
#     docker build -t fascicle .
#     docker run --rm -v "$PWD:/data" fascicle demo
#
# and its tests, which need more, without and with the slow ones:
#
#     docker build -t fascicle-test --target test . && docker run --rm fascicle-test
#     docker run --rm fascicle-test make test-slow
#
# What is computed once a machine stays if /home/fascicle/.cache is a volume.

FROM python:3.11-slim-bookworm AS base
# Netgen loads OpenGL and X11 though it opens no window, libigl OpenMP; VTK draws by EGL
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        libegl1 libgl1 libgl1-mesa-dri libgomp1 libsm6 libxext6 \
    && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home fascicle && install -d -o fascicle /data
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1

FROM base AS test
RUN apt-get update \
    && apt-get install -y --no-install-recommends chromium g++ make \
    && rm -rf /var/lib/apt/lists/*
USER fascicle
WORKDIR /home/fascicle/source
COPY --chown=fascicle . .
RUN make .venv/.installed
CMD ["make", "test"]

FROM base
RUN --mount=type=bind,target=/source,rw \
    pip install -c /source/constraints.txt '/source[build]'
USER fascicle
WORKDIR /data
ENTRYPOINT ["fascicle"]
CMD ["--help"]
