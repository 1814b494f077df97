/* An I2C bus with a PCA9685 on it where there is none, to be preloaded: the plain file that $FAKE_I2C names answers the
 * ioctls of linux/i2c-dev.h, and holds the chip's 256 registers, so that all processes which open it share the chip.
 * Each open, lock, question for a lock, and transfer is a line in the file that $FAKE_I2C_LOG names: monotonic time in ns,
 * process, and what. While there is a file $FAKE_I2C.held the bus is held down: transfers fail after a second.
 * Whoever opens a path below /dev/i2c- gets that bus, too; an attempt to open one below /dev/ttyAMA is a line and fails. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/i2c-dev.h>
#include <linux/i2c.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { MODE1 = 0, LED15_OFF_H = 69, ALL_LED_ON_L = 250, PRE_SCALE = 254, AUTO_INCREMENT = 0x20, ADDRESS = 0x40 };

static int (*next_ioctl)(int, unsigned long, ...);
static int (*next_fcntl)(int, int, ...);
static int (*next_fcntl64)(int, int, ...);
static int (*next_open)(const char *, int, ...);
static int (*next_open64)(const char *, int, ...);

__attribute__((constructor)) static void find_next(void)
{
    next_ioctl = (int (*)(int, unsigned long, ...))dlsym(RTLD_NEXT, "ioctl");
    next_fcntl = (int (*)(int, int, ...))dlsym(RTLD_NEXT, "fcntl");
    next_fcntl64 = (int (*)(int, int, ...))dlsym(RTLD_NEXT, "fcntl64");
    next_open = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, "open");
    next_open64 = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, "open64");
    if (!next_fcntl64)
        next_fcntl64 = next_fcntl; /* before glibc 2.28 */
}

static int is_bus(int fd)
{
    struct stat bus, opened;
    const char *path = getenv("FAKE_I2C");

    return path && !stat(path, &bus) && !fstat(fd, &opened) && bus.st_ino == opened.st_ino && bus.st_dev == opened.st_dev;
}

static void note(const char *what)
{
    const char *path = getenv("FAKE_I2C_LOG");
    char line[256];
    struct timespec now;
    int length, fd;

    if (!path || (fd = next_open(path, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600)) < 0)
        return;
    clock_gettime(CLOCK_MONOTONIC, &now);
    length = snprintf(line, sizeof line, "%lld %d %s\n", now.tv_sec * 1000000000LL + now.tv_nsec, (int)getpid(), what);
    if (write(fd, line, length) != length)
        abort();
    close(fd);
}

static void note_bytes(const char *what, int first, const unsigned char *bytes, int length)
{
    char text[128];
    int at = snprintf(text, sizeof text, "%s %02x ", what, first);

    for (int i = 0; i < length; i++)
        at += snprintf(text + at, sizeof text - at, "%02x", bytes[i]);
    note(text);
}

static unsigned char get(int fd, int number)
{
    unsigned char value = 0;

    if (pread(fd, &value, 1, number) != 1)
        abort();
    return value;
}

static void put(int fd, int number, unsigned char value)
{
    int first = number >= ALL_LED_ON_L && number < PRE_SCALE ? 6 + number - ALL_LED_ON_L : number;
    int last = first == number ? number : LED15_OFF_H;

    for (; first <= last; first += 4)
        if (pwrite(fd, &value, 1, first) != 1)
            abort();
}

/* One transfer of SMBus: a byte, or a block of the length in front of it. */
static int transfer(int fd, struct i2c_smbus_ioctl_data *request)
{
    int is_block = request->size == I2C_SMBUS_I2C_BLOCK_DATA;
    int length = is_block ? request->data->block[0] : 1, number = request->command;
    unsigned char *bytes = is_block ? request->data->block + 1 : &request->data->byte;
    char held[4096];

    if (!is_block && request->size != I2C_SMBUS_BYTE_DATA) {
        errno = EOPNOTSUPP;
        return -1;
    }
    snprintf(held, sizeof held, "%s.held", getenv("FAKE_I2C"));
    if (!access(held, F_OK)) {
        note("held");
        sleep(1);
        errno = ETIMEDOUT;
        return -1;
    }
    for (int i = 0; i < length; i++, number += !!(get(fd, MODE1) & AUTO_INCREMENT))
        if (request->read_write == I2C_SMBUS_READ)
            bytes[i] = get(fd, number);
        else
            put(fd, number, bytes[i]);
    note_bytes(request->read_write == I2C_SMBUS_READ ? "read" : "write", request->command, bytes, length);
    return 0;
}

int ioctl(int fd, unsigned long request, ...)
{
    va_list arguments;
    void *argument;

    va_start(arguments, request);
    argument = va_arg(arguments, void *);
    va_end(arguments);
    if (!is_bus(fd))
        return next_ioctl(fd, request, argument);
    if (request == I2C_FUNCS) {
        *(unsigned long *)argument = I2C_FUNC_I2C | I2C_FUNC_SMBUS_EMUL;
        return 0;
    }
    if (request == I2C_SLAVE) {
        char text[32];

        snprintf(text, sizeof text, "address %02lx", (unsigned long)argument);
        note(text);
        if ((unsigned long)argument == ADDRESS)
            return 0;
        errno = EINVAL;
        return -1;
    }
    if (request == I2C_SMBUS)
        return transfer(fd, argument);
    errno = ENOTTY;
    return -1;
}

static int noted_fcntl(int (*next)(int, int, ...), int fd, int command, void *argument)
{
    int result = next(fd, command, argument);

    if ((command == F_SETLK || command == F_GETLK) && is_bus(fd)) {
        struct flock *lock = argument;
        char text[128];

        if (command == F_SETLK)
            snprintf(text, sizeof text, "lock %llx: %d", (long long)lock->l_start, result);
        else
            snprintf(text, sizeof text, "holder of %llx: %d", (long long)lock->l_start,
                     lock->l_type == F_UNLCK ? 0 : (int)lock->l_pid);
        note(text);
    }
    return result;
}

int fcntl(int fd, int command, ...)
{
    va_list arguments;
    void *argument;

    va_start(arguments, command);
    argument = va_arg(arguments, void *);
    va_end(arguments);
    return noted_fcntl(next_fcntl, fd, command, argument);
}

int fcntl64(int fd, int command, ...)
{
    va_list arguments;
    void *argument;

    va_start(arguments, command);
    argument = va_arg(arguments, void *);
    va_end(arguments);
    return noted_fcntl(next_fcntl64, fd, command, argument);
}

static int noted_open(int (*next)(const char *, int, ...), const char *path, int flags, int mode)
{
    int fd;

    if (getenv("FAKE_I2C") && !strncmp(path, "/dev/i2c-", 9))
        path = getenv("FAKE_I2C");
    if (!strncmp(path, "/dev/ttyAMA", 11)) {
        note(path);
        errno = ENOENT;
        return -1;
    }
    fd = next(path, flags, mode);
    if (fd >= 0 && is_bus(fd))
        note("open");
    return fd;
}

int open(const char *path, int flags, ...)
{
    va_list arguments;
    int mode;

    va_start(arguments, flags);
    mode = va_arg(arguments, int);
    va_end(arguments);
    return noted_open(next_open, path, flags, mode);
}

int open64(const char *path, int flags, ...)
{
    va_list arguments;
    int mode;

    va_start(arguments, flags);
    mode = va_arg(arguments, int);
    va_end(arguments);
    return noted_open(next_open64, path, flags, mode);
}
