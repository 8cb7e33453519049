/* A program behind FMI 3.0 for co-simulation with CAN by FMI-LS-BUS 1.0.

   The program speaks the lockstep protocol on standard input and output: hello, grant, yield, stop.
   resources/command.txt has its words, one a line, and resources/hello.json the line of hello. The
   clock CAN.Tx_Clock counts down to the next wake-up that the program asks for. A tick of it sends
   one grant; what the program yields is the content of the outputs at the same instant. Operations
   of the node itself, such as its error state, leave at a tick of their own. */

#define _POSIX_C_SOURCE 200809L

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#ifndef MSG_NOSIGNAL
#define MSG_NOSIGNAL 0
#endif

extern char **environ;

enum { OK = 0, ERROR = 3 };
enum { UNKNOWN = 0, UNCHANGED = 1, CHANGED = 2 };
enum { CAN_RX = 1, CAN_RX_CLOCK, CAN_TX, CAN_TX_CLOCK, SERIAL_TX, RADIO_TX, SERIAL_RX, RADIO_RX, NOTIFICATIONS, TRUTH = 100 };
enum { FORMAT_ERROR = 0x01, CAN_TRANSMIT = 0x10, CONFIRM = 0x20, LOST = 0x30, BUS_ERROR = 0x31,
       CONFIGURATION = 0x40, STATUS = 0x41, WAKEUP = 0x42, HEAD = 8 };
enum { SET_BIT_RATE = 1, SET_LOST = 4, BUFFER = 1, NOT_ACKNOWLEDGED = 5, FIRST_TO_SEE = 1 };
enum { ERROR_ACTIVE = 1, ERROR_PASSIVE = 2, BUS_OFF = 3, PASSIVE_FROM = 128, OFF_FROM = 256 };
enum { BIT_RATE = 250000, RECOVERY_BITS = 128 * 11 };
enum { TRUTH_MAX = 64, WORDS_MAX = 64, START_MS = 30000, LEASE_MS = 5000, END_MS = 1000 };
#define LINE_MAX_BYTES (1u << 20)
#define NS_PER_S 1000000000LL
#define NEVER_NS INT64_MAX

typedef struct {
    char *bytes;
    size_t length, room;
} Text;

typedef void (*Log)(void *environment, int status, const char *category, const char *message);

typedef struct {
    char *resources;
    void *environment;
    Log log;
    pid_t program;
    int line;               /* Connection to the program; -1: none. */
    int64_t now_ns, next_ns;
    int ticked, interval;   /* Tx_Clock ticked and is not answered; what is known of its interval. */
    Text frames, serial, radio;             /* Inputs of the next grant, as items of JSON lists. */
    Text notices;                           /* Operations of the node itself. */
    int notified, tec, rec, status;         /* Error counters and the state that was reported. */
    int64_t back_ns;                        /* End of the recovery from bus off; NEVER_NS: none. */
    Text can_tx, serial_tx, radio_tx;       /* Outputs at this instant. */
    Text answer;
    double truth[TRUTH_MAX];
} Shim;

/* Text of any length. */

static int put(Text *text, const void *bytes, size_t length) {
    if (text->length + length + 1 > text->room) {
        size_t room = 2 * (text->length + length + 1);
        char *grown = realloc(text->bytes, room);
        if (grown == NULL) return 0;
        text->bytes = grown;
        text->room = room;
    }
    if (length > 0) memcpy(text->bytes + text->length, bytes, length);
    text->length += length;
    text->bytes[text->length] = '\0';
    return 1;
}

static int print(Text *text, const char *format, ...) {
    char piece[128];
    va_list values;
    va_start(values, format);
    int length = vsnprintf(piece, sizeof piece, format, values);
    va_end(values);
    return length >= 0 && (size_t)length < sizeof piece && put(text, piece, (size_t)length);
}

static void clear(Text *text) {
    text->length = 0;
    if (text->bytes != NULL) text->bytes[0] = '\0';
}

static void drop(Text *text) {
    free(text->bytes);
    memset(text, 0, sizeof *text);
}

static int refuse(Shim *shim, const char *format, ...) {
    char message[512];
    va_list values;
    va_start(values, format);
    vsnprintf(message, sizeof message, format, values);
    va_end(values);
    if (shim->log != NULL) shim->log(shim->environment, ERROR, "logStatusError", message);
    return ERROR;
}

/* The program. */

static int read_file(const char *folder, const char *name, Text *text) {
    char path[4096], piece[4096];
    if ((size_t)snprintf(path, sizeof path, "%s%s", folder, name) >= sizeof path) return 0;
    FILE *file = fopen(path, "rb");
    if (file == NULL) return 0;
    size_t length;
    int good = put(text, "", 0);
    while (good && (length = fread(piece, 1, sizeof piece, file)) > 0) good = put(text, piece, length);
    fclose(file);
    return good;
}

static int64_t clock_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static void end_program(Shim *shim) {
    if (shim->line >= 0) close(shim->line);
    shim->line = -1;
    if (shim->program <= 0) return;
    for (int waited = 0; waitpid(shim->program, NULL, WNOHANG) == 0; waited++) {
        if (waited == END_MS / 10) kill(shim->program, SIGKILL);
        struct timespec pause = {0, 10000000};
        nanosleep(&pause, NULL);
    }
    shim->program = 0;
}

static int start_program(Shim *shim) {
    Text words = {0};
    char *argv[WORDS_MAX + 1], *rest = NULL;
    int count = 0, ends[2];
    if (!read_file(shim->resources, "command.txt", &words)) {
        return refuse(shim, "%scommand.txt cannot be read", shim->resources);
    }
    for (char *word = strtok_r(words.bytes, "\n", &rest); word != NULL && count < WORDS_MAX;
         word = strtok_r(NULL, "\n", &rest)) {
        argv[count++] = word;
    }
    argv[count] = NULL;
    if (count == 0 || socketpair(AF_UNIX, SOCK_STREAM, 0, ends) != 0) {
        drop(&words);
        return refuse(shim, "%scommand.txt names no program", shim->resources);
    }
    /* Programs of other instances must not hold this connection open. */
    fcntl(ends[0], F_SETFD, FD_CLOEXEC);
    fcntl(ends[1], F_SETFD, FD_CLOEXEC);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, ends[1], 0);
    posix_spawn_file_actions_adddup2(&actions, ends[1], 1);
    int failed = posix_spawnp(&shim->program, argv[0], &actions, NULL, argv, environ);
    posix_spawn_file_actions_destroy(&actions);
    close(ends[1]);
    shim->line = ends[0];
    if (failed) {
        shim->program = 0;
        refuse(shim, "%s cannot be started: %s", argv[0], strerror(failed));
    }
    drop(&words);
    return failed ? ERROR : OK;
}

/* Send a line and wait for the line that answers it. */
static int exchange(Shim *shim, const Text *sent, int lease_ms) {
    int64_t until_ms = clock_ms() + lease_ms;
    for (size_t at = 0; at < sent->length;) {
        ssize_t length = send(shim->line, sent->bytes + at, sent->length - at, MSG_NOSIGNAL);
        if (length < 0 && errno == EINTR) continue;
        if (length <= 0) return refuse(shim, "the program ended");
        at += (size_t)length;
    }
    clear(&shim->answer);
    while (memchr(shim->answer.bytes ? shim->answer.bytes : "", '\n', shim->answer.length) == NULL) {
        char piece[65536];
        struct pollfd wait = {shim->line, POLLIN, 0};
        int64_t left_ms = until_ms - clock_ms();
        int ready = poll(&wait, 1, left_ms > 0 ? (int)left_ms : 0);
        if (ready < 0 && errno == EINTR) continue;
        if (ready <= 0) return refuse(shim, "the program hangs: no answer within %d ms", lease_ms);
        ssize_t length = recv(shim->line, piece, sizeof piece, 0);
        if (length <= 0) return refuse(shim, "the program ended");
        if (!put(&shim->answer, piece, (size_t)length)) return refuse(shim, "out of memory");
        if (shim->answer.length > LINE_MAX_BYTES) return refuse(shim, "the answer is too long");
    }
    return OK;
}

/* The value of a member of the answer; NULL: there is none. */
static const char *member(const Shim *shim, const char *name) {
    char key[64];
    snprintf(key, sizeof key, "\"%s\"", name);
    const char *at = strstr(shim->answer.bytes, key);
    if (at == NULL) return NULL;
    at += strlen(key);
    at += strspn(at, " \t");
    if (*at++ != ':') return NULL;
    return at + strspn(at, " \t");
}

static int is_type(const Shim *shim, const char *type) {
    const char *value = member(shim, "type");
    return value != NULL && *value == '"' && strncmp(value + 1, type, strlen(type)) == 0;
}

static int take_wakeup(Shim *shim) {
    const char *value = member(shim, "next_wakeup_ns");
    if (value == NULL) return refuse(shim, "the answer has no next_wakeup_ns");
    int64_t next_ns = strtoll(value, NULL, 10);
    shim->next_ns = next_ns > shim->now_ns ? next_ns : shim->now_ns;
    shim->interval = CHANGED;
    return OK;
}

/* The items of a list of lists or strings, as they stand. */
static int copy_items(Shim *shim, const char *name, Text *text) {
    const char *at = member(shim, name);
    if (at == NULL) return OK;
    if (*at != '[') return refuse(shim, "%s is no list", name);
    const char *from = ++at;
    int depth = 1, quoted = 0;
    for (; depth > 0; at++) {
        if (*at == '\0') return refuse(shim, "%s does not end", name);
        if (*at == '"') quoted = !quoted;
        else if (!quoted) depth += (*at == '[') - (*at == ']');
    }
    return put(text, from, (size_t)(at - 1 - from)) ? OK : refuse(shim, "out of memory");
}

/* Operations of the bus. */

static void put_number(uint8_t *at, uint32_t value, int bytes) {
    for (int index = 0; index < bytes; index++) at[index] = (uint8_t)(value >> (8 * index));
}

static uint32_t number(const uint8_t *at, int bytes) {
    uint32_t value = 0;
    for (int index = 0; index < bytes; index++) value |= (uint32_t)at[index] << (8 * index);
    return value;
}

static int transmit(Text *text, uint32_t id, const uint8_t *data, size_t length) {
    uint8_t operation[24] = {0};
    put_number(operation, CAN_TRANSMIT, 4);
    put_number(operation + 4, (uint32_t)(16 + length), 4);
    put_number(operation + 8, id, 4);
    put_number(operation + 14, (uint32_t)length, 2);
    memcpy(operation + 16, data, length);
    return put(text, operation, 16 + length);
}

static int take_frames(Shim *shim) {
    Text items = {0};
    if (copy_items(shim, "frames", &items) != OK) return ERROR;
    const char *at = items.bytes;
    while (at != NULL && (at = strchr(at, '[')) != NULL) {
        char *after;
        unsigned long id = strtoul(at + 1, &after, 10);
        const char *text = strchr(after, '"');
        uint8_t data[8];
        size_t length = 0;
        for (text = text ? text + 1 : ""; *text && *text != '"' && length < sizeof data; text += 2) {
            unsigned byte;
            if (sscanf(text, "%2x", &byte) != 1) break;
            data[length++] = (uint8_t)byte;
        }
        if (shim->status == BUS_OFF && *text == '"' && id <= 0x7FF) {
            at = text;
            continue;
        }
        if (*text != '"' || id > 0x7FF || !transmit(&shim->can_tx, (uint32_t)id, data, length)) {
            drop(&items);
            return refuse(shim, "a frame of the program is no CAN frame");
        }
        at = text;
    }
    drop(&items);
    return OK;
}

static int format_error(Shim *shim, const uint8_t *operation, size_t length) {
    uint8_t head[10];
    if (length > 1000) length = 1000;
    put_number(head, FORMAT_ERROR, 4);
    put_number(head + 4, (uint32_t)(10 + length), 4);
    put_number(head + 8, (uint32_t)length, 2);
    return put(&shim->notices, head, sizeof head) && put(&shim->notices, operation, length);
}

/* Say something to the bus that takes a few bytes. */
static int say(Shim *shim, uint32_t code, const void *content, size_t length) {
    uint8_t head[HEAD];
    put_number(head, code, 4);
    put_number(head + 4, (uint32_t)(HEAD + length), 4);
    return put(&shim->notices, head, sizeof head) && put(&shim->notices, content, length);
}

static int configure(Shim *shim) {
    uint8_t rate[5] = {SET_BIT_RATE}, lost[2] = {SET_LOST, BUFFER};
    put_number(rate + 1, BIT_RATE, 4);
    return say(shim, CONFIGURATION, rate, sizeof rate) && say(shim, CONFIGURATION, lost, sizeof lost);
}

/* Report the error state if it has changed. */
static int report(Shim *shim) {
    int status = shim->tec >= OFF_FROM                                  ? BUS_OFF
                 : shim->tec >= PASSIVE_FROM || shim->rec >= PASSIVE_FROM ? ERROR_PASSIVE
                                                                          : ERROR_ACTIVE;
    if (status == shim->status) return 1;
    uint8_t content = (uint8_t)(shim->status = status);
    if (status == BUS_OFF) shim->back_ns = shim->now_ns + RECOVERY_BITS * NS_PER_S / BIT_RATE;
    return say(shim, STATUS, &content, 1);
}

/* Count a good frame. */
static void count_frame(Shim *shim, int own) {
    if (!shim->notified || shim->status == BUS_OFF) return;
    if (own) shim->tec -= shim->tec > 0;
    else shim->rec = shim->rec >= PASSIVE_FROM ? PASSIVE_FROM - 1 : shim->rec - (shim->rec > 0);
}

/* Count a destroyed frame. A passive sender does not count a missing acknowledgement. */
static void count_error(Shim *shim, const uint8_t *operation) {
    int code = operation[12], first = operation[13] == FIRST_TO_SEE, own = operation[14];
    if (!shim->notified || shim->status == BUS_OFF) return;
    if (own && !(code == NOT_ACKNOWLEDGED && shim->status != ERROR_ACTIVE)) shim->tec += 8;
    if (!own) shim->rec += first ? 8 : 1;
    if (shim->rec > 255) shim->rec = 255;
}

static int64_t due_ns(const Shim *shim) {
    int64_t next_ns = shim->next_ns < shim->back_ns ? shim->next_ns : shim->back_ns;
    return shim->notices.length > 0 ? shim->now_ns : next_ns;
}

static int receive(Shim *shim, const uint8_t *bytes, size_t length) {
    shim->interval = CHANGED;
    for (size_t at = 0; at < length;) {
        size_t rest = length - at;
        const uint8_t *operation = bytes + at;
        uint32_t code = rest < HEAD ? 0 : number(operation, 4);
        uint32_t size = rest < HEAD ? 0 : number(operation + 4, 4);
        if (size < HEAD || size > rest) {
            return format_error(shim, operation, rest) ? OK : refuse(shim, "out of memory");
        }
        int good = 1;
        if (code == CAN_TRANSMIT && shim->status == BUS_OFF) {
            /* A node that is bus off receives nothing. */
        } else if (code == CAN_TRANSMIT && size >= 16 && size == 16 + number(operation + 14, 2) &&
            size <= 24 && operation[12] == 0 && operation[13] == 0 && number(operation + 8, 4) <= 0x7FF) {
            good = print(&shim->frames, "%s[%lld,%u,\"", shim->frames.length ? "," : "",
                         (long long)shim->now_ns, (unsigned)number(operation + 8, 4));
            for (uint32_t index = 16; index < size; index++) {
                good = good && print(&shim->frames, "%02x", operation[index]);
            }
            good = good && print(&shim->frames, "\"]");
            count_frame(shim, 0);
        } else if (code == CONFIRM && size == 12) {
            count_frame(shim, 1);
        } else if (code == BUS_ERROR && size == 15) {
            count_error(shim, operation);
        } else if (code != LOST && code != FORMAT_ERROR && code != CONFIGURATION && code != STATUS &&
                   code != WAKEUP) {
            /* The bus keeps frames that lose arbitration. The program never sleeps. */
            good = format_error(shim, operation, size);
        }
        good = good && report(shim);
        if (!good) return refuse(shim, "out of memory");
        at += size;
    }
    return OK;
}

static int take_truth(Shim *shim) {
    const char *at = member(shim, "truth");
    if (at == NULL || *at != '[') return OK;
    for (int index = 0; index < TRUTH_MAX && *at != ']' && *at != '\0'; index++) {
        char *after;
        shim->truth[index] = strtod(at + 1, &after);
        at = after + strspn(after, " \t");
    }
    return OK;
}

/* One grant, and what the program yields. */
static int run_program(Shim *shim) {
    Text line = {0};
    int good = print(&line, "{\"type\":\"grant\",\"now_ns\":%lld", (long long)shim->now_ns);
    struct {
        const char *name;
        Text *items;
    } lists[] = {{"frames", &shim->frames}, {"serial", &shim->serial}, {"radio", &shim->radio}};
    for (int index = 0; index < 3; index++) {
        good = good && print(&line, ",\"%s\":[", lists[index].name) &&
               put(&line, lists[index].items->bytes, lists[index].items->length) && put(&line, "]", 1);
        clear(lists[index].items);
    }
    good = good && put(&line, "}\n", 2);
    int status = good ? exchange(shim, &line, LEASE_MS) : refuse(shim, "out of memory");
    drop(&line);
    if (status != OK) return status;
    if (!is_type(shim, "yield")) return refuse(shim, "the program answers with no yield");
    if (take_wakeup(shim) != OK || take_frames(shim) != OK || take_truth(shim) != OK) return ERROR;
    if (copy_items(shim, "serial", &shim->serial_tx) != OK) return ERROR;
    return copy_items(shim, "radio", &shim->radio_tx);
}

/* What is due at a tick of the clock. */
static int tick(Shim *shim) {
    int good = 1;
    shim->ticked = 0;
    shim->interval = CHANGED;
    if (shim->now_ns >= shim->back_ns) {
        shim->tec = shim->rec = 0;
        shim->back_ns = NEVER_NS;
        good = report(shim);
    }
    good = good && put(&shim->can_tx, shim->notices.bytes, shim->notices.length);
    clear(&shim->notices);
    if (!good) return refuse(shim, "out of memory");
    return shim->now_ns >= shim->next_ns ? run_program(shim) : OK;
}

/* The functions of FMI 3.0. */

const char *fmi3GetVersion(void) { return "3.0"; }

void fmi3FreeInstance(void *instance) {
    Shim *shim = instance;
    if (shim == NULL) return;
    end_program(shim);
    Text *texts[] = {&shim->frames, &shim->serial, &shim->radio, &shim->notices, &shim->can_tx,
                     &shim->serial_tx, &shim->radio_tx, &shim->answer};
    for (int index = 0; index < 8; index++) drop(texts[index]);
    free(shim->resources);
    free(shim);
}

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                  _Bool visible, _Bool logging, _Bool events, _Bool early,
                                  const uint32_t *required, size_t count, void *environment,
                                  Log log, void *update) {
    (void)name, (void)visible, (void)logging, (void)early, (void)required, (void)count, (void)update;
    Shim *shim = calloc(1, sizeof *shim);
    if (shim == NULL) return NULL;
    shim->line = -1;
    shim->environment = environment;
    shim->log = log;
    shim->resources = strdup(resources ? resources : "");
    Text known = {0};
    int same = shim->resources != NULL && read_file(shim->resources, "token.txt", &known) &&
               strncmp(known.bytes, token, strlen(token)) == 0;
    drop(&known);
    if (!same || !events) {
        refuse(shim, same ? "event mode is needed" : "the token or the resources do not fit");
        fmi3FreeInstance(shim);
        return NULL;
    }
    return shim;
}

void *fmi3InstantiateModelExchange(void) { return NULL; }
void *fmi3InstantiateScheduledExecution(void) { return NULL; }
int fmi3SetDebugLogging(void *instance, _Bool on, size_t count, const char **names) { return OK; }

int fmi3EnterInitializationMode(void *instance, _Bool tolerant, double tolerance, double start_s,
                                _Bool ends, double end_s) {
    Shim *shim = instance;
    Text hello = {0};
    shim->now_ns = llround(start_s * 1e9);
    if (start_program(shim) != OK) return ERROR;
    int status = read_file(shim->resources, "hello.json", &hello) && put(&hello, "\n", 1)
                     ? exchange(shim, &hello, START_MS)
                     : refuse(shim, "%shello.json cannot be read", shim->resources);
    drop(&hello);
    if (status != OK) return status;
    if (is_type(shim, "refuse")) {
        const char *reason = member(shim, "reason");
        return refuse(shim, "the program refuses: %.400s", reason ? reason : "");
    }
    if (!is_type(shim, "ready")) return refuse(shim, "the program answers hello with no ready");
    shim->status = ERROR_ACTIVE;
    shim->back_ns = NEVER_NS;
    return configure(shim) ? take_wakeup(shim) : refuse(shim, "out of memory");
}

int fmi3ExitInitializationMode(void *instance) { return OK; }
int fmi3EnterEventMode(void *instance) { return OK; }
int fmi3EnterStepMode(void *instance) { return OK; }

int fmi3Terminate(void *instance) {
    Shim *shim = instance;
    Text line = {0};
    if (shim->line >= 0 && print(&line, "{\"type\":\"stop\",\"now_ns\":%lld}\n", (long long)shim->now_ns)) {
        exchange(shim, &line, LEASE_MS);
    }
    drop(&line);
    end_program(shim);
    return OK;
}

int fmi3Reset(void *instance) {
    Shim *shim = instance;
    end_program(shim);
    Text *texts[] = {&shim->frames, &shim->serial, &shim->radio, &shim->notices,
                     &shim->can_tx, &shim->serial_tx, &shim->radio_tx};
    for (int index = 0; index < 7; index++) clear(texts[index]);
    shim->now_ns = shim->next_ns = 0;
    shim->ticked = shim->interval = shim->tec = shim->rec = shim->notified = 0;
    return OK;
}

int fmi3SetClock(void *instance, const uint32_t *references, size_t count, const _Bool *values) {
    for (size_t index = 0; index < count; index++) {
        if (references[index] == CAN_TX_CLOCK) ((Shim *)instance)->ticked |= values[index];
        else if (references[index] != CAN_RX_CLOCK) return ERROR;
    }
    return OK;
}

int fmi3GetIntervalFraction(void *instance, const uint32_t *references, size_t count,
                            uint64_t *counters, uint64_t *resolutions, int *qualifiers) {
    Shim *shim = instance;
    for (size_t index = 0; index < count; index++) {
        if (references[index] != CAN_TX_CLOCK) return ERROR;
        counters[index] = (uint64_t)(due_ns(shim) - shim->now_ns);
        resolutions[index] = NS_PER_S;
        qualifiers[index] = shim->interval;
        if (shim->interval == CHANGED) shim->interval = UNCHANGED;
    }
    return OK;
}

int fmi3GetIntervalDecimal(void *instance, const uint32_t *references, size_t count,
                           double *intervals, int *qualifiers) {
    for (size_t index = 0; index < count; index++) {
        uint64_t counter, resolution;
        if (fmi3GetIntervalFraction(instance, references + index, 1, &counter, &resolution,
                                    qualifiers + index) != OK) return ERROR;
        intervals[index] = (double)counter / (double)resolution;
    }
    return OK;
}

int fmi3SetBoolean(void *instance, const uint32_t *references, size_t count, const _Bool *values,
                   size_t total) {
    for (size_t index = 0; index < count; index++) {
        if (references[index] != NOTIFICATIONS) return ERROR;
        ((Shim *)instance)->notified = values[index];
    }
    return OK;
}

int fmi3SetBinary(void *instance, const uint32_t *references, size_t count, const size_t *sizes,
                  const uint8_t *const *values, size_t total) {
    Shim *shim = instance;
    for (size_t index = 0; index < count; index++) {
        Text *items = references[index] == SERIAL_RX ? &shim->serial : &shim->radio;
        if (references[index] == CAN_RX) {
            if (receive(shim, values[index], sizes[index]) != OK) return ERROR;
        } else if (references[index] != SERIAL_RX && references[index] != RADIO_RX) {
            return ERROR;
        } else if (sizes[index] > 0) {
            if (items->length > 0 && !put(items, ",", 1)) return ERROR;
            if (!put(items, values[index], sizes[index])) return ERROR;
        }
    }
    return OK;
}

int fmi3GetBinary(void *instance, const uint32_t *references, size_t count, size_t *sizes,
                  const uint8_t **values, size_t total) {
    Shim *shim = instance;
    if (shim->ticked && tick(shim) != OK) return ERROR;
    for (size_t index = 0; index < count; index++) {
        Text *text = references[index] == CAN_TX      ? &shim->can_tx
                     : references[index] == SERIAL_TX ? &shim->serial_tx
                     : references[index] == RADIO_TX  ? &shim->radio_tx
                                                      : NULL;
        if (text == NULL) return ERROR;
        sizes[index] = text->length;
        values[index] = (const uint8_t *)(text->bytes ? text->bytes : "");
    }
    return OK;
}

int fmi3GetFloat64(void *instance, const uint32_t *references, size_t count, double *values,
                   size_t total) {
    Shim *shim = instance;
    if (shim->ticked && tick(shim) != OK) return ERROR;
    for (size_t index = 0; index < count; index++) {
        uint32_t place = references[index] - TRUTH;
        if (references[index] == 0) values[index] = (double)shim->now_ns / 1e9;
        else if (place < TRUTH_MAX) values[index] = shim->truth[place];
        else return ERROR;
    }
    return OK;
}

int fmi3UpdateDiscreteStates(void *instance, _Bool *again, _Bool *ends, _Bool *nominals,
                             _Bool *states, _Bool *known, double *next_s) {
    Shim *shim = instance;
    if (shim->ticked && tick(shim) != OK) return ERROR;
    clear(&shim->can_tx);
    clear(&shim->serial_tx);
    clear(&shim->radio_tx);
    *again = *ends = *nominals = *states = *known = 0;
    return OK;
}

int fmi3DoStep(void *instance, double from_s, double step_s, _Bool no_set, _Bool *event, _Bool *ends,
               _Bool *early, double *last_s) {
    Shim *shim = instance;
    int64_t now_ns = llround((from_s + step_s) * 1e9);
    if (now_ns > due_ns(shim)) {
        return refuse(shim, "the step to %lld ns passes the tick at %lld ns", (long long)now_ns,
                      (long long)due_ns(shim));
    }
    shim->now_ns = now_ns;
    *event = *ends = *early = 0;
    *last_s = from_s + step_s;
    return OK;
}

/* The standard asks for all functions; this FMU has no use for these. */
#define NOT_THERE(name) int fmi3##name(void) { return ERROR; }
NOT_THERE(ActivateModelPartition) NOT_THERE(CompletedIntegratorStep)
NOT_THERE(DeserializeFMUState) NOT_THERE(EnterConfigurationMode)
NOT_THERE(EnterContinuousTimeMode) NOT_THERE(EvaluateDiscreteStates)
NOT_THERE(ExitConfigurationMode) NOT_THERE(FreeFMUState) NOT_THERE(GetAdjointDerivative)
NOT_THERE(GetBoolean) NOT_THERE(GetClock) NOT_THERE(GetContinuousStateDerivatives)
NOT_THERE(GetContinuousStates) NOT_THERE(GetDirectionalDerivative) NOT_THERE(GetEventIndicators)
NOT_THERE(GetFMUState) NOT_THERE(GetFloat32) NOT_THERE(GetInt16) NOT_THERE(GetInt32)
NOT_THERE(GetInt64) NOT_THERE(GetInt8) NOT_THERE(GetNominalsOfContinuousStates)
NOT_THERE(GetNumberOfContinuousStates) NOT_THERE(GetNumberOfEventIndicators)
NOT_THERE(GetNumberOfVariableDependencies) NOT_THERE(GetOutputDerivatives)
NOT_THERE(GetShiftDecimal) NOT_THERE(GetShiftFraction) NOT_THERE(GetString) NOT_THERE(GetUInt16)
NOT_THERE(GetUInt32) NOT_THERE(GetUInt64) NOT_THERE(GetUInt8) NOT_THERE(GetVariableDependencies)
NOT_THERE(SerializeFMUState) NOT_THERE(SerializedFMUStateSize) 
NOT_THERE(SetContinuousStates) NOT_THERE(SetFMUState) NOT_THERE(SetFloat32)
NOT_THERE(SetFloat64) NOT_THERE(SetInt16) NOT_THERE(SetInt32) NOT_THERE(SetInt64)
NOT_THERE(SetInt8) NOT_THERE(SetIntervalDecimal) NOT_THERE(SetIntervalFraction)
NOT_THERE(SetShiftDecimal) NOT_THERE(SetShiftFraction) NOT_THERE(SetString) NOT_THERE(SetTime)
NOT_THERE(SetUInt16) NOT_THERE(SetUInt32) NOT_THERE(SetUInt64) NOT_THERE(SetUInt8)
