#!/bin/sh
# The main job on the simulated sample: each step is a command that an operator could type.
set -eu
stcal="$BIN/stcal"
sample=sample_telemetry
rm -rf "$RUN"
mkdir -p "$RUN"

echo "The first run compiles the kernels, which takes half a minute."
for part in calibration validation; do
  "$stcal" ingest $sample/*.$part.csv.gz --store "$RUN/store/$part" --config configs/st16.toml
done

validations=""
for n in $SENSORS; do
  sensor="ST16-$n"
  out="$RUN/$sensor"
  mkdir -p "$out"
  # The tables of each step go to a file; a refusal or an error still shows on standard error.
  {
    "$stcal" fit --batch --store "$RUN/store/calibration" --sensor "$sensor" \
      --initial "$sample/$sensor.initial.json" --out "$out/fit"
    "$stcal" validate --store "$RUN/store/validation" --sensor "$sensor" \
      --baseline "$sample/$sensor.initial.json" --candidate "$out/fit/calibration.json" \
      --out "$out/validation"
    "$stcal" uplink build --calibration "$out/fit/calibration.json" \
      --parent "$sample/$sensor.initial.json" --validation "$out/validation/validation.json" \
      --store "$RUN/store/calibration" --target configs/targets/st16_cfs.toml \
      --out "$out/uplink"
    "$stcal" report "$out/fit/fit.json" "$out/validation/validation.json" \
      --out "$out/report.html"
  } > "$out/tables.txt"
  echo "$sensor: fitted, validated, upload file built; report $out/report.html"
  validations="$validations $out/validation/validation.json"
done

echo
# shellcheck disable=SC2086
"$stcal" summary $validations
echo "Reports: $RUN/ST16-*/report.html    Upload files: $RUN/ST16-*/uplink/serial-*/"
echo "Tables of every step: $RUN/ST16-*/tables.txt"
