#!/bin/sh
# A base image where none can be pulled: Debian bookworm with its Python 3.11, as appl-base:bookworm. Needs root.
#   sudo docker/base.sh && BASE=appl-base:bookworm docker compose -f docker/compose.yaml up --build
# CA_CERTIFICATES: a folder of *.crt that the image shall trust as well, for networks with a certificate of their own.
set -eu
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
debootstrap --variant=minbase --include=python3,python3-venv,ca-certificates bookworm "$root" "${DEBIAN_MIRROR:-}"
if [ -n "${CA_CERTIFICATES:-}" ]; then
    cp "$CA_CERTIFICATES"/*.crt "$root/usr/local/share/ca-certificates/"
    chroot "$root" update-ca-certificates
fi
rm -rf "$root"/var/lib/apt/lists/* "$root"/var/cache/apt/* "$root"/usr/share/doc/* "$root"/usr/share/man/* \
    "$root"/usr/share/locale/* "$root"/usr/share/info/*
tar -C "$root" -c . | docker import --change "ENV PIP_CERT=/etc/ssl/certs/ca-certificates.crt" - appl-base:bookworm
