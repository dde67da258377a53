# trustlab with everything in environment.lock: docker build -t trustlab . && docker run -p 8888:8888 trustlab
FROM python:3.12-slim
RUN apt-get update && apt-get install --yes --no-install-recommends make git && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home lab
USER lab
# WORKDIR alone would make a folder of root's, in which lab could not build .venv.
RUN mkdir /home/lab/trustlab
WORKDIR /home/lab/trustlab
COPY --chown=lab . .
RUN make .venv/.stamp
EXPOSE 8888
CMD [".venv/bin/jupyter", "lab", "--ip=0.0.0.0", "--no-browser", "--notebook-dir=notebooks"]
