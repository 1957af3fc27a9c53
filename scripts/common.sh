# Shared by the scripts of this folder; sourced, with the checkout as working directory.
# shellcheck shell=bash

say() { printf '[%s] %s\n' "$(basename "$0")" "$*"; }

fail() {
    say "$*" >&2
    exit 1
}

# is_current FILE TEXT: the step that wrote TEXT to FILE, when it had ended well, need not run again.
is_current() { [ -f "$1" ] && [ "$(cat "$1")" = "$2" ]; }

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
    "$dir/bin/python" -m pip install --quiet "pip>=20.3"
    "$dir/bin/python" -m pip install --quiet --requirement "$requirements"
    printf '%s\n' "$key" >"$dir/$requirements.stamp"
}
