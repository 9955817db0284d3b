#!/bin/sh
# Run every experiment in its large size: some two hours on two cores. Run again, it continues where
# it was stopped; options are those of `jaxreplay run`.
#
#     sh experiments/large.sh --workers 2
#
# How a run ends is mostly a matter of where the cube stands, so most of these have one run at each
# of many positions.

set -e
cd "$(dirname "$0")/.."
options="$*" reading=

study() {
    name=$1
    shift
    # shellcheck disable=SC2086 # several words
    .venv/bin/jaxreplay run "experiments/$name.toml" --out "results/large/$name$reading" "$@" $options
}

many() { # positions ahead and aside, and what else differs
    name=$1 ahead=$2 aside=$3
    shift 3
    study "$name" --set "positions.x.linspace=[0.26,0.39,$ahead]" \
        --set "positions.y.linspace=[-0.09,0.09,$aside]" "$@"
}

many theta_i 15 20 --set repeats=1
study rivals
many interpolation 5 6 --set repeats=10
many dithering 10 15 --set repeats=1 --set "axis.theta_i=[0.1,0.01]" --set "axis.motor_unit=[0.005,0.01,0.02]"
many battery 10 15 --set repeats=1 --set "axis.theta_i=[0.1,0.01]" --set "axis.battery=[0.2,0.6,1.0]"
many light 10 15 --set repeats=1 --set "axis.theta_i=[0.1,0.01]"
study grid
study sigma
study noise
study outside

# Equation 6 as printed, at a θ_I that suits it; theta_i and outside, above, have both readings.
reading=_same_tau options="--set jump=same_tau $options"
study grid --set "axis.theta_i.logspace=[-0.5,-6.5,4]" --set "axis.theta_tau=[0.01,0.05,0.2]"
options="--set theta_i=0.001 $options"
many interpolation 5 6 --set repeats=10
many dithering 15 20 --set repeats=1 --set "axis.motor_unit=[0.005,0.01,0.02]"
many battery 15 20 --set repeats=1 --set "axis.battery=[0.2,0.6,1.0]"
many light 15 20 --set repeats=1
study sigma
study noise
