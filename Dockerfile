# Obstacle problems in a container. Build, then solve with results in a folder of your own:
#   docker build -t fenicsx-obstacle .
#   mkdir -p results
#   docker run --rm --user "$(id -u)" -v "$PWD/results:/results" fenicsx-obstacle demo
#   docker run --rm --user "$(id -u)" -v "$PWD/results:/results" --entrypoint mpirun fenicsx-obstacle -n 2 fenicsx-obstacle demo
FROM debian:trixie

COPY debian-packages.txt /tmp/
# everything comes from Debian: nothing of PyPI is fetched
RUN apt-get update \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $(cat /tmp/debian-packages.txt) \
    python3-click python3-msgspec python3-setuptools python3-tomli-w python3-tqdm \
 && rm -rf /var/lib/apt/lists/* /tmp/debian-packages.txt

COPY pyproject.toml README.md /opt/fenicsx_obstacle/
COPY fenicsx_obstacle /opt/fenicsx_obstacle/fenicsx_obstacle
COPY demos /opt/fenicsx_obstacle/demos
# editable: the demo finds demos/ beside the package
RUN python3 -m venv --system-site-packages /opt/venv \
 && /opt/venv/bin/pip install --no-build-isolation --no-deps --no-cache-dir -e /opt/fenicsx_obstacle \
 && ln -s /opt/venv/bin/fenicsx-obstacle /usr/local/bin/ \
 && useradd --create-home obstacle \
 && install -d -m 1777 /results /var/cache/obstacle

# any user may compile forms and draw; containers forbid the system call that Open MPI copies with
ENV OMP_NUM_THREADS=1 XDG_CACHE_HOME=/var/cache/obstacle MPLCONFIGDIR=/var/cache/obstacle/matplotlib \
    OMPI_MCA_smsc=^cma OMPI_MCA_pml=ob1 OMPI_MCA_btl=^tcp,uct,openib,ofi OMPI_MCA_mpi_yield_when_idle=1
USER obstacle
WORKDIR /results
ENTRYPOINT ["fenicsx-obstacle"]
