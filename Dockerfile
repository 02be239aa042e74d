# The demo in a container: docker build -t kinedex . && docker run --rm -v "$PWD/out:/out" kinedex
FROM node:24-slim AS page
WORKDIR /explorer/page
COPY explorer/page ./
RUN npm ci --ignore-scripts --no-audit --no-fund && npx vite build

FROM python:3.12-slim

RUN useradd --create-home --uid 1000 kinedex && mkdir /out && chown kinedex /out
WORKDIR /app
COPY requirements.lock ./
RUN pip install --no-cache-dir --require-hashes -r requirements.lock

COPY . .
COPY --from=page /explorer/built explorer/built
RUN pip install --no-cache-dir . --no-deps \
    && rm -rf /app/*

USER 1000
WORKDIR /out
VOLUME /out
ENTRYPOINT ["kinedex"]
CMD ["demo", "/out/demo-store"]
