# Obstacle problems in a container; docs/start.md has the commands.
FROM debian:trixie

COPY debian-packages.txt debian-packages-python.txt /tmp/
# Everything comes from Debian: nothing of PyPI is fetched. Debian's dolfinx brings what one needs to compile against it in
# C++; FFCx compiles C at run time, so that gcc, libc and Python keep their headers, and the rest goes in the same layer.
RUN apt-get update \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
    $(cat /tmp/debian-packages*.txt) python3-pyvista xauth xvfb \
 && dpkg-query -W -f '${Package}\n' | grep -E '^(g\+\+|gfortran|lib(boost|dolfinx|eigen|stdc\+\+|vtk).*-dev$)' \
  | xargs dpkg --purge --force-depends \
 && apt-get clean && rm -rf /var/lib/apt/lists/* /tmp/debian-packages*.txt /usr/share/doc/*

COPY . /opt/fenicsx_obstacle
# editable: demos/ and tests/ are found beside the package
RUN python3 -m venv --system-site-packages /opt/fenicsx_obstacle/.venv \
 && cd /opt/fenicsx_obstacle \
 && .venv/bin/pip install --no-build-isolation --no-deps --no-cache-dir -e . \
 && touch .venv/image \
 && ln -s /opt/fenicsx_obstacle/.venv/bin/fenicsx-obstacle /usr/local/bin/ \
 && useradd --create-home obstacle \
 && install -d -m 1777 /results /var/cache/obstacle

# any user may compile forms and draw; containers forbid the system call that Open MPI copies with
ENV HOME=/tmp XDG_CACHE_HOME=/var/cache/obstacle MPLCONFIGDIR=/var/cache/obstacle/matplotlib \
    HYPOTHESIS_STORAGE_DIRECTORY=/tmp/hypothesis OMPI_MCA_smsc=^cma \
    OMP_NUM_THREADS=1 SCOTCH_PTHREAD_NUMBER=1
# what the demos compile is there from the first solve on
RUN /opt/fenicsx_obstacle/obstacle --ranks 1 demo --output /tmp/demo && rm -rf /tmp/* && chmod -R a+rwX /var/cache/obstacle

USER obstacle
WORKDIR /results
ENTRYPOINT ["/opt/fenicsx_obstacle/obstacle"]
