"""Settings of the real daemon: flags over environment over file, errors that say where, --print-config, --self-test."""

import pytest
from daemon import run


def settings(program, *arguments, **variables):
    """What --print-config says, as a dictionary."""
    result = run(program, *arguments, "--print-config", **variables)
    assert result.returncode == 0, result.stderr
    return dict(line.split(" = ", 1) for line in result.stdout.splitlines())


def write(folder, text):
    path = folder / "barycastd.toml"
    path.write_text(text)
    return str(path)


def test_flags_win_over_environment_over_file(real_daemon, tmp_path):
    config = write(tmp_path, '# a comment\nthreads = 3\nrequests-max = 5\ncache-bytes = "3MB"\nlog-format = "json"\n')
    assert settings(real_daemon, "--config", config)["requests-max"] == "5"
    assert settings(real_daemon, "--config", config)["cache-bytes"] == "3145728"
    environment = {"BARYCASTD_REQUESTS_MAX": "6", "BARYCASTD_CACHE_BYTES": "4KiB"}
    mixed = settings(real_daemon, "--config", config, "--requests-max", "7", **environment)
    assert mixed["threads"] == "3"
    assert mixed["cache-bytes"] == "4096"
    assert mixed["requests-max"] == "7"
    assert mixed["log-format"] == '"json"'
    assert settings(real_daemon, BARYCASTD_CONFIG=config)["threads"] == "3"
    # Empty is unset, and what orchestrators put into the environment is none of ours.
    assert settings(real_daemon, BARYCASTD_THREADS="", BARYCASTD_PORT="tcp://10.0.0.1:50051")["threads"] == "0"


def test_flags_without_a_value_come_from_anywhere(real_daemon, tmp_path):
    config = write(tmp_path, "exit-on-stdin-close = true\n")
    assert settings(real_daemon)["exit-on-stdin-close"] == "false"
    assert settings(real_daemon, "--config", config)["exit-on-stdin-close"] == "true"
    assert settings(real_daemon, "--config", config,
                    BARYCASTD_EXIT_ON_STDIN_CLOSE="false")["exit-on-stdin-close"] == "false"
    assert settings(real_daemon, BARYCASTD_EXIT_ON_STDIN_CLOSE="true")["exit-on-stdin-close"] == "true"


def test_printed_settings_are_a_file(real_daemon, tmp_path):
    arguments = ("--listen", "unix:/tmp/a b", "--threads", "2", "--cache-bytes", "1GiB", "--exit-on-stdin-close",
                 "--metrics-listen", "127.0.0.1:0", "--drain-seconds", "7")
    first = run(real_daemon, *arguments, "--print-config").stdout
    again = run(real_daemon, "--config", write(tmp_path, first), "--print-config")
    assert again.returncode == 0, again.stderr
    assert again.stdout == first
    assert 'listen = "unix:/tmp/a b"' in first


@pytest.mark.parametrize("text, key, allowed", [
    ("threads = 9999\n", "threads", "1024"),
    ("threads = many\n", "threads", "many"),
    ('cache-bytes = "lots"\n', "cache-bytes", "lots"),
    ('log-level = "loud"\n', "log-level", "critical"),
    ("no-such-key = 1\n", "no-such-key", "cache-bytes"),
    ("[limits]\ncache-bytes = 1\n", "limits.cache-bytes", "no such setting"),
    ("threads = [1, 2]\n", "threads", "give one"),
    ('listen = "unix:/a#b"\n', "line 1", "cannot hold a #"),
    ("port-file = '/tmp/a#b'\n", "line 1", "cannot hold a #"),
    ("probe = \"127.0.0.1:1\"\n", "probe", "no such setting"),
])
def test_errors_of_the_file_name_it_and_the_key(real_daemon, tmp_path, text, key, allowed):
    path = write(tmp_path, text)
    result = run(real_daemon, "--config", path, "--print-config")
    assert result.returncode == 2
    assert result.stderr.startswith(f"barycastd: {path}: {key}: "), result.stderr
    assert allowed in result.stderr
    assert result.stderr.count("\n") == 1


def test_errors_of_the_environment_name_the_variable(real_daemon):
    result = run(real_daemon, "--print-config", BARYCASTD_REQUESTS_MAX="-3")
    assert result.returncode == 2
    assert result.stderr.startswith("barycastd: environment variable BARYCASTD_REQUESTS_MAX: "), result.stderr
    assert "-3" in result.stderr or "POSITIVE" in result.stderr


@pytest.mark.parametrize("arguments, named", [
    (("--no-such-flag",), "--no-such-flag"),
    (("--threads", "9999"), "--threads"),
    (("--log-format", "xml"), "--log-format"),
    (("--config", "/no/such/file"), "/no/such/file"),
    (("extra",), "extra"),
    (("--listen", "127.0.0.1"), "--listen: must be HOST:PORT"),
    (("--listen", "127.0.0.1:65536"), "--listen: must be HOST:PORT"),
    (("--listen", ":1"), "--listen: must be HOST:PORT"),
    (("--metrics-listen", "127.0.0.1:http"), "--metrics-listen: must be HOST:PORT"),
])
def test_errors_of_the_command_line(real_daemon, arguments, named):
    result = run(real_daemon, *arguments)
    assert result.returncode == 2
    assert named in result.stderr


def test_self_test_says_what_it_tested(real_daemon):
    result = run(real_daemon, "--self-test")
    assert result.returncode == 0
    assert result.stdout == "barycastd: the self-test passed for harmonic, mean value, positive mean value\n"


def test_help_is_there_whatever_the_file(real_daemon, tmp_path):
    result = run(real_daemon, "--help", "--config", write(tmp_path, "nonsense = [\n"))
    assert result.returncode == 0
    assert "BARYCASTD_CACHE_BYTES" in result.stdout
