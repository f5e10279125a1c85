# docker build -t localiser . && docker run --rm -v "$PWD/results:/results" localiser
# replays the log that ships; `docker run --rm localiser localiser --help` lists the commands.
FROM python:3.11-slim
WORKDIR /app
COPY requirements.lock .
RUN pip install --no-cache-dir --require-hashes -r requirements.lock
COPY . .
RUN pip install --no-cache-dir --no-build-isolation --no-deps .
CMD ["localiser", "replay", "logs/corridor", "--out", "/results"]
