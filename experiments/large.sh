#!/bin/sh
# Run every experiment in its large size: with ten sets of demonstrations, and for each of them one
# run at each of 30 positions (of grid, sigma and noise, which have many cells, at six). Some four
# hours on two cores. Run again, it continues where it was stopped; options are those of
# `jaxreplay run`.
#
#     sh experiments/large.sh --workers 2
#     SEEDS="1 2 3" sh experiments/large.sh  # fewer sets, or others

set -e
cd "$(dirname "$0")/.."
options="$*" reading= seeds="${SEEDS:-1 2 3 4 5 6 7 8 9 10}"

at() { # positions ahead and aside, a study, and what differs from its file
    ahead=$1 aside=$2 name=$3
    shift 3
    for seed in $seeds; do
        # shellcheck disable=SC2086 # several words
        .venv/bin/jaxreplay run "experiments/$name.toml" --out "results/large/$name$reading/$seed" \
            --set seed="$seed" --set repeats=1 --set "positions.x.linspace=[0.26,0.39,$ahead]" \
            --set "positions.y.linspace=[-0.09,0.09,$aside]" "$@" $options
    done
}

study() {
    at 5 6 "$@"
}

study theta_i
study dithering --set "axis.theta_i=[0.1]" --set "axis.motor_unit=[0.005,0.01,0.02]"
study battery --set "axis.theta_i=[0.1]" --set "axis.battery=[0.2,0.6,1.0]"
study interpolation --set "axis.theta_i=[0.316227766017,0.1]" --set "axis.records=[2,4,6,10,20]"
study light --set "axis.theta_i=[0.1]"
study jumps
study sensors
study rivals
study outside --set "positions.x.linspace=[0.2,0.65,10]" --set "positions.y.linspace=[-0.3,0.3,13]"
at 2 3 sigma
at 2 3 noise

# Equation 6 as printed, at a θ_I that suits it; theta_i and outside, above, have both readings.
reading=_same_tau options="--set jump=same_tau $options"
at 2 3 grid --set "axis.theta_i.logspace=[-0.5,-6.5,4]" --set "axis.theta_tau=[0.01,0.05,0.2]"
study dithering --set "axis.theta_i=[0.001]" --set "axis.motor_unit=[0.005,0.01,0.02]"
study battery --set "axis.theta_i=[0.001]" --set "axis.battery=[0.2,0.6,1.0]"
study interpolation --set "axis.theta_i=[0.001]" --set "axis.records=[2,4,6,10,20]"
study light --set "axis.theta_i=[0.001]"

reading= options="$*" seeds="${SEEDS:-1 2 3 4 5}"
at 2 3 grid
