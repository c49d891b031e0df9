# The wheel alone, on CPUs, as a user without rights:
#   docker build -t nw-eval .
#   docker run --rm -v "$PWD:/work" --user "$(id -u):$(id -g)" nw-eval run hurdles --policy ./my-policy
# docs/how-to/docker.md says more.

ARG PYTHON=3.12-slim-bookworm

FROM python:${PYTHON} AS build
WORKDIR /source
RUN pip install --no-cache-dir build==1.6.1 hatchling
COPY . .
RUN for package in . harness/nw_base harness/nw_splat harness/nw_gate harness/nw_twin harness/nw_learn; do \
      python -m build --no-isolation --wheel --outdir /dist "$package" || exit; \
    done

FROM python:${PYTHON} AS install
# Where torch comes without CUDA's two gigabytes; the version is that of constraints.txt.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
COPY constraints.txt /
RUN python -m venv /opt/nw-eval \
 && /opt/nw-eval/bin/pip install --no-cache-dir --index-url "${TORCH_INDEX}" "$(grep ^torch== /constraints.txt)"
COPY --from=build /dist/ /dist/
RUN /opt/nw-eval/bin/pip install --no-cache-dir -c /constraints.txt --find-links /dist \
      "$(ls /dist/nw_eval-*.whl)[onnxruntime,torch]" nw-twin nw-learn

FROM python:${PYTHON}
COPY --from=install /opt/nw-eval /opt/nw-eval
# Any user may keep a cache here, and nobody may touch another's: as in /tmp.
RUN useradd --create-home --uid 10001 nw-eval \
 && mkdir -m 1777 /cache \
 && install -d -o nw-eval -g nw-eval /work
ENV PATH=/opt/nw-eval/bin:$PATH NW_EVAL_CACHE=/cache
USER nw-eval
WORKDIR /work
ENTRYPOINT ["nw-eval"]
CMD ["--help"]
