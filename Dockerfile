# docker build -t mavnav . && docker run --rm -v "$PWD:/data" mavnav replay drive.mcap
# Build it on the kind of processor that it runs on: on another one, every process compiles the kernels again.
FROM python:3.12-slim
ENV MAVNAV_CACHE_DIR=/opt/mavnav-kernels
COPY . /tmp/mavnav
RUN python -m pip install --no-cache-dir /tmp/mavnav && rm -rf /tmp/mavnav
RUN mavnav warmup
USER 1000
WORKDIR /data
ENTRYPOINT ["mavnav"]
