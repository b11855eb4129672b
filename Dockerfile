# The package with exactly the packages of requirements.lock, for planning on a CPU:
#   docker build -t oimppi-warp .
#   docker run --rm oimppi-warp demo
#   docker run --rm -p 8080:8080 oimppi-warp view task02 --host 0.0.0.0
# hadolint finds nothing in this file; no image has been built of it yet.
# On an NVIDIA GPU, with its container toolkit: docker run --rm --gpus all ...

FROM python:3.11-slim AS build
WORKDIR /source
COPY requirements.lock ./
RUN python -m venv /opt/oimppi && \
    /opt/oimppi/bin/pip install --no-cache-dir --require-hashes -r requirements.lock
COPY pyproject.toml README.md LICENSE ./
COPY kernels kernels
COPY scenes scenes
COPY oimppi_warp oimppi_warp
RUN /opt/oimppi/bin/pip install --no-cache-dir --no-deps --no-build-isolation .

FROM python:3.11-slim
COPY --from=build /opt/oimppi /opt/oimppi
RUN useradd --create-home --uid 1000 oimppi && mkdir /work && chown oimppi /work
USER 1000
WORKDIR /work
ENV PATH=/opt/oimppi/bin:$PATH
# The kernels are compiled for the processor that builds the image; another kind compiles its own in its first run.
RUN oimppi warmup --engine quasistatic
EXPOSE 8080
ENTRYPOINT ["oimppi"]
CMD ["demo"]
