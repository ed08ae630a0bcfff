"""DOLFINx from Debian: its packages by apt-get, or a private tree in the user's cache folder.

The tree is built once with mmdebstrap and entered with bubblewrap.
"""

from __future__ import annotations

import functools
import glob
import os
import pwd
import re
import shlex
import shutil
import time
from pathlib import Path

import common
from common import CACHE, agree, die, logged, output, say

PACKAGES = (
    *("python3-dolfinx", "python3-gmsh", "python3-scipy", "python3-matplotlib", "python3-tqdm"),
    *("python3-adios2", "python3-adios2-mpi"),  # read the fields that were written
    *("python3-meshio", "python3-h5py"),  # read meshes of other programs
    *("python3-pytest", "python3-pytest-xdist", "python3-hypothesis"),
    "libopenblas0-pthread",  # reference BLAS makes direct solves in 3D several times slower
    *("gcc", "g++"),  # forms are compiled at run time
    *("python3-setuptools", "python3-pip", "python3-venv"),
)
#: What renders pictures of solids with PyVista, which pip installs next to a tree. Not part of the
#: name of a tree, since nothing else needs it, and pictures say what is missing.
PICTURES = ("libegl1", "libgl1-mesa-dri")
PYVISTA = ("pyvista==0.49.1", "vtk==9.7.2")  # as in wheels.lock
FORMAT = 1  # raise it when the way a tree is built changes: a new tree replaces the old one
KEYRING = "/usr/share/keyrings/debian-archive-keyring.gpg"
MPI_SESSIONS = "/run/mpi"  # inside a private tree, where nothing outlives the run
IS_ROOT = os.geteuid() == 0
CAN_APT = IS_ROOT and shutil.which("apt-get") is not None
#: A user's subordinate ids become those of a Debian.
AS_FAKE_ROOT = ("unshare", "--user", "--map-root-user", "--map-auto")


@functools.cache
def update() -> None:
    """Fetch the package lists, once; an installation that follows tells what is not there."""
    output("apt-get", "-q", "-o", "DPkg::Lock::Timeout=300", "update")


def install(*packages: str) -> None:
    """Install packages with apt-get."""
    update()
    output("dpkg", "--configure", "-a")  # an interrupted earlier installation
    command = "apt-get -q -y -o DPkg::Lock::Timeout=300 --no-install-recommends install".split()
    variables = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    if not logged("apt.log", [*command, *packages], variables):
        die(f"apt-get could not install {' '.join(packages)}")


def use_packages() -> bool:
    """Whether DOLFINx could be installed as a package of this Debian."""
    update()
    policy = output("apt-cache", "policy", "python3-dolfinx")
    candidate = re.search(r"Candidate: (?:\d+:)?(\d+\.\d+)", policy)
    if not candidate or not common.is_supported(candidate[1]):
        return False
    agree(
        "installing Debian's FEniCSx in this system with apt-get, a few minutes:",
        " ".join((*PACKAGES, *PICTURES)),
    )
    start = time.monotonic()
    install(*PACKAGES, *PICTURES)
    say(f"installed in {time.monotonic() - start:.0f} s")
    return True


def tree(suite: str) -> Path:
    """Where the tree of a release is; its name changes with what is in it."""
    return CACHE / f"debian-{suite}-{common.short_hash(FORMAT, suite, *PACKAGES)}"


def find_or_build(suite: str) -> Path:
    """The tree, with the tools that enter it."""
    folder = tree(suite)
    install_tools(folder.is_dir())
    check_sandbox()
    if not folder.is_dir():
        with common.build_lock():
            if not folder.is_dir():
                build(folder, suite)
    return folder


def install_tools(is_built: bool) -> None:
    """What enters the tree and, where there is none, what builds it."""
    needs = {
        "bubblewrap": shutil.which("bwrap"),
        "mmdebstrap": is_built or shutil.which("mmdebstrap"),
        "debian-archive-keyring": is_built or os.path.exists(KEYRING),
        "uidmap": is_built or IS_ROOT or shutil.which("newuidmap"),
    }
    missing = [name for name, there in needs.items() if not there]
    names = " ".join(missing)
    if missing and CAN_APT:
        agree(f"installing {names} in this system with apt-get")
        install(*missing)
    elif missing and shutil.which("apt-get"):
        say(f"DOLFINx 0.9 or newer was not found, and a private Debian tree needs: {names}")
        die(f"ask an administrator for:  apt-get install {names}")
    elif missing:
        say("no usable DOLFINx was found, and only a Debian system can build a private one")
        say("install Python 3.12 or newer as python3, or FEniCSx 0.9 - 0.11 (conda-forge, a")
        die("container image), and try again")
    elif not is_built and not IS_ROOT:
        user = pwd.getpwuid(os.geteuid()).pw_name
        ids = Path("/etc/subuid").read_text() if os.path.exists("/etc/subuid") else ""
        if not re.search(rf"^({re.escape(user)}|{os.geteuid()}):", ids, re.MULTILINE):
            ranges = "--add-subuids 200000-265535 --add-subgids 200000-265535"
            say("without root, a private Debian tree needs subordinate user ids")
            die(f"ask an administrator for:  usermod {ranges} {user}")


def check_sandbox() -> None:
    """Say what to do where bubblewrap may not do its work."""
    command = "bwrap --unshare-pid --ro-bind / / --dev /dev --proc /proc true".split()
    done = common.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        die(
            f"bubblewrap cannot start a sandbox here: {done.stderr.strip()}",
            "in a container, start it with the right to create namespaces; without root, ask an",
            "administrator to allow user namespaces (kernel.unprivileged_userns_clone=1,",
            "user.max_user_namespaces > 0, kernel.apparmor_restrict_unprivileged_userns=0);",
            "or install FEniCSx 0.9 - 0.11 (conda-forge, a container image, Debian 13)",
        )


def mirror() -> str:
    """The mirror that this machine's apt already uses, whichever style its sources have."""
    if os.environ.get("VMDG_DEBIAN_MIRROR"):
        return os.environ["VMDG_DEBIAN_MIRROR"]
    form = "$(REPO_URI) $(RELEASE) $(COMPONENT)"
    targets = output("apt-get", "indextargets", "--format", form, "Created-By: Packages")
    debian = "bullseye|bookworm|trixie|forky|duke|sid|oldstable|stable|testing|unstable"
    found = re.search(rf"^(\S+) ({debian}) main$", targets, re.MULTILINE)
    if found is None:
        die("apt on this machine has no Debian mirror: name one in VMDG_DEBIAN_MIRROR")
    uri, _, mirrors = found[1].partition("mirror+file:")
    # A list of mirrors instead of a mirror: its first line is the preferred one.
    return uri or Path(mirrors).read_text().split()[0]


def build(folder: Path, suite: str) -> None:
    """Build the tree next to its place and move it there. Only called under the build lock."""
    part = Path(f"{folder}.part")
    for leftover in CACHE.glob("debian-*.part"):  # of a killed build
        remove(leftover)
    name = "unstable" if suite == "sid" else "13"
    say(f"building a private Debian {name} tree in {folder}, 2-3 minutes, 3 GB")
    start = time.monotonic()
    if not logged(f"{folder.name}.log", bootstrap(suite, part)) or not imports(part, folder.name):
        remove(part)
        die("the tree could not be built")
    part.rename(folder)
    pip = inside(folder, ["/usr/bin/python3", *"-m pip install --no-input".split(), *PYVISTA])
    if common.run(pip, capture_output=True, env=variables(folder)).returncode != 0:
        say("PyVista could not be installed: pictures of solids will be missing")
    say(f"built in {time.monotonic() - start:.0f} s")
    common.remove_old(f"debian-{suite}", folder, remove)


def bootstrap(suite: str, part: Path) -> list[str]:
    """Command that builds a tree."""
    # Own process and mount namespaces, and a parent-death signal: if this process is killed,
    # however rudely, every process of the build and every mount inside the tree go with it.
    if IS_ROOT:
        unshare, mode = ["unshare"], ["--mode=root"]
    else:
        # A home folder closed to others is closed to apt's download user as well.
        unshare, mode = [*AS_FAKE_ROOT], ["--mode=unshare", '--aptopt=APT::Sandbox::User "root"']
    if suite == "sid":  # a snapshot of unstable is valid for a week only
        mode.append('--aptopt=Acquire::Check-Valid-Until "false"')
    for setting in shlex.split(output("apt-config", "shell", "proxy", "Acquire::http::Proxy")):
        mode.append(f'--aptopt=Acquire::http::Proxy "{setting.partition("=")[2]}"')
    return [
        *("setpriv", "--pdeathsig", "KILL", *unshare, "--mount", "--pid", "--fork"),
        *("--kill-child", "--mount-proc", "mmdebstrap", *mode),
        *("--variant=apt", "--components=main", f"--keyring={KEYRING}"),
        f"--architectures={output('dpkg', '--print-architecture').strip()}",
        f"--include={','.join((*PACKAGES, *PICTURES))}",
        '--aptopt=Apt::Install-Recommends "false"',
        "--dpkgopt=force-unsafe-io",  # no fsync: an interrupted build is thrown away anyway
        *(f"--dpkgopt=path-exclude=/usr/share/{name}/*" for name in ("man", "locale", "doc")),
        *("--dpkgopt=path-include=/usr/share/doc/*/copyright", suite, str(part), mirror()),
    ]


def imports(part: Path, name: str) -> bool:
    """Whether every module of a new tree can really be imported."""
    # Mount points must exist beforehand because the tree is mounted read-only.
    for place in ("etc/ssl/certs", "usr/share/ca-certificates", "usr/local/share/ca-certificates"):
        (part / place).mkdir(parents=True, exist_ok=True)
    for file in ("resolv.conf", "hosts", "passwd", "group"):
        open(part / "etc" / file, "a").close()
    modules = ", ".join(("dolfinx", "petsc4py.PETSc", *common.MODULES, "adios2.file_reader"))
    command = inside(part, ["/usr/bin/python3", "-c", f"import {modules}"])
    own = {**variables(part), "XDG_CACHE_HOME": f"{part}/tmp"}
    return logged(f"{name}.import.log", command, own)


def remove(folder: Path) -> None:
    """Remove a tree, but never through a mount: rm would empty the host's /dev, mounted inside."""
    if f" {folder.resolve()}/" in Path("/proc/self/mountinfo").read_text():
        die(f"something is mounted inside {folder}: unmount it, then try again")
    command = ["rm", "-rf", "--one-file-system", "--", str(folder)]
    # Some files of other users belong to their subordinate ids.
    common.run(command if IS_ROOT else [*AS_FAKE_ROOT, *command], check=True)


def variables(folder: Path) -> dict[str, str]:
    """Environment of a command in a tree."""
    # Settings of the host's Python, compilers and libraries mean nothing (or harm) inside.
    host = r"(LD_|PYENV|VIRTUAL_ENV|CONDA|LC_).*|(PETSC|SLEPC)_(DIR|ARCH)|(OPAL|PRTE|PMIX)_PREFIX"
    host = "|".join((host, "CC|CXX|CPP|LDSHARED|LANG|LANGUAGE", *common.PYTHON_VARIABLES))
    kept = {name: value for name, value in os.environ.items() if not re.fullmatch(host, name)}
    if not os.path.isdir(kept.get("TMPDIR") or "/tmp"):
        kept.pop("TMPDIR", None)
    # What pip installs goes next to the tree, which is read-only, and uses the tree's packages.
    packages, path = f"{folder}.packages", "/usr/local/bin:/usr/bin:/bin"
    kept.update(PATH=f"{path}:{packages}/bin", PYTHONPATH=str(common.ROOT), LC_ALL="C.UTF-8")
    kept.update(PYTHONUSERBASE=packages, PIP_USER="1", PIP_BREAK_SYSTEM_PACKAGES="1")
    kept["PIP_ROOT_USER_ACTION"] = "ignore"
    # mpirun names its session after its process number, and every sandbox counts from one:
    # in a shared /tmp it would meet the session of another one, or of a killed run.
    return {**kept, "PRTE_MCA_prte_tmpdir_base": MPI_SESSIONS}


def inside(folder: Path, command: list[str], *seen: str) -> list[str]:
    """Command that runs another one in a tree and sees some folders wherever they are."""
    # The root of the sandbox is an empty tmpfs. The tree gives /usr and /etc, read-only; the host
    # gives every top-level folder that no system uses for itself (home, tmp, work, scratch, ...),
    # so paths mean the same inside and outside.
    options = "--die-with-parent --unshare-pid --tmpfs / --dev /dev --proc /proc".split()
    options += ["--ro-bind", "/sys", "/sys", "--ro-bind", f"{folder}/usr", "/usr"]
    options += ["--ro-bind", f"{folder}/etc", "/etc", "--dir", "/run", "--dir", "/var/tmp"]
    options += ["--dir", MPI_SESSIONS]
    for name in ("bin", "sbin", "lib", "lib32", "lib64", "libx32"):
        if (folder / name).is_symlink():
            options += ["--symlink", os.readlink(folder / name), f"/{name}"]
    files = "/etc/resolv.conf /etc/hosts /etc/passwd /etc/group /etc/ssl/certs"
    files += " /usr/share/ca-certificates /usr/local/share/ca-certificates"
    for path in filter(os.path.exists, files.split()):
        options += ["--ro-bind", path, path]
    system = r"/(bin|boot|dev|etc|lib.*|lost\+found|proc|run|sbin|sys|usr|var)"
    for path in sorted(filter(os.path.isdir, glob.glob("/*"))):
        if not re.fullmatch(system, path) and os.access(path, os.R_OK | os.X_OK):
            options += ["--bind", path, path]
    home, temporary = os.environ.get("HOME") or "/", os.environ.get("TMPDIR") or "/tmp"
    kernels = os.environ.get("XDG_CACHE_HOME") or home
    for path in (common.ROOT, kernels, home, temporary, os.getcwd(), *seen):
        options += bind_system_folder(folder, os.path.realpath(path))
    # bwrap dies of Ctrl-C and would take Python with it before Python can react; so it is started
    # deaf to the signal, and only the command hears it.
    end = ["--chdir", os.getcwd(), "--", "env", "--default-signal=INT"]
    return ["bwrap", *options, *end, *command]


def bind_system_folder(tree: Path, path: str) -> list[str]:
    """Options for a folder below a system folder (/var/home, /run/media, /usr/src, ...)."""
    if not os.path.isdir(path) or not re.match("/(var|run|usr|etc)/", path):
        return []
    if re.match("/(usr|etc)/", path):
        place = f"{tree}{path}"
        if os.path.exists(place) and os.listdir(place):
            return []  # never hides what the tree itself has there, such as /usr/bin
        os.makedirs(place, exist_ok=True)
    return ["--bind", path, path]
