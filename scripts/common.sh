# SPDX-License-Identifier: BSD-3-Clause
# Shared by the scripts of this folder; sourced, with the checkout as working directory.
# shellcheck shell=bash

# What the scripts start neither needs nor changes the user's home folder: caches, ROS's logs and packages of
# `pip install --user` are those of a home folder inside the checkout. Variables that may lead back are unset.
# One script starts another: the first has seen the user's. Where HOME is not set, ~ is the account's.
export USERS_HOME=${USERS_HOME-${HOME-~}}
export HOME=$PWD/.ws/home
mkdir -p "$HOME"
unset XDG_CACHE_HOME XDG_CONFIG_HOME XDG_DATA_HOME XDG_STATE_HOME MPLCONFIGDIR
unset ROS_HOME ROS_LOG_DIR ROS_TEST_RESULTS_DIR PYTHONUSERBASE

say() { printf '[%s] %s\n' "$(basename "$0")" "$*"; }

fail() {
    say "$*" >&2
    exit 1
}

# is_current FILE TEXT: the step that wrote TEXT to FILE, when it had ended well, need not run again.
is_current() { [ -f "$1" ] && [ "$(cat "$1")" = "$2" ]; }

# pip_install PYTHON ARGUMENTS...: with the user's pip settings (an index, a proxy, certificates), which are only read.
pip_install() {
    local python=$1
    shift
    # pip asks rustc for its version, and rustup's makes a folder; the order counts: HOME changes for what follows it.
    RUSTUP_HOME=$HOME/.rustup HOME=$USERS_HOME PYTHONNOUSERSITE=1 "$python" -m pip --no-cache-dir --quiet install "$@"
}

# python_environment DIR PYTHON REQUIREMENTS [VENV_OPTION...]: makes or updates a virtual environment with the pins.
python_environment() {
    local dir=$1 python=$2 requirements=$3 key
    shift 3
    key=$({ pwd && "$python" --version && cat requirements*.txt; } | sha256sum)
    # What is installed for the tests includes what is needed to run.
    if is_current "$dir/requirements-test.txt.stamp" "$key" || is_current "$dir/$requirements.stamp" "$key"; then
        return
    fi
    say "installing $requirements into $dir with $("$python" --version)"
    rm -f "$dir"/*.stamp
    "$python" -m venv "$@" "$dir"
    # Ubuntu 20.04's own pip is too old for the wheels.
    pip_install "$dir/bin/python" "pip>=20.3"
    pip_install "$dir/bin/python" --requirement "$requirements"
    printf '%s\n' "$key" >"$dir/$requirements.stamp"
}

# find_python38: prints the path of a Python 3.8, nothing where there is none: the first that works of those on PATH
# (pyenv's is on PATH even when it is not chosen there, and then fails) and those that pyenv has installed for the user.
find_python38() {
    local account_home candidate
    account_home=$(getent passwd "$(id -u)" | cut -d: -f6) || true
    while IFS= read -r candidate; do
        if "$candidate" -c 'import sys; print(sys.executable)' 2>/dev/null; then
            return
        fi
    done < <(
        type -aP python3.8 || true
        printf '%s\n' {"$USERS_HOME","$account_home"}/.pyenv/versions/3.8*/bin/python3.8
    )
}
