#!/bin/sh
# Builds train.fmu beside this script, for the machine that it runs on.
set -e
cd "$(dirname "$0")"
case "$(uname -s)" in
Darwin) system=darwin suffix=dylib ;;
*) system=linux suffix=so ;;
esac
case "$(uname -m)" in
arm64 | aarch64) processor=aarch64 ;;
*) processor=x86_64 ;;
esac
folder=binaries/$processor-$system
mkdir -p "$folder"
# Fused operations would give other digits on other processors.
${CC:-cc} -O2 -ffp-contract=off -std=c11 -fPIC -shared -o "$folder/train.$suffix" train.c -lm
rm -f train.fmu
python3 -m zipfile -c train.fmu modelDescription.xml binaries
rm -r binaries
