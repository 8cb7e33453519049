/* Compiled replacement for slow numpy code: parses text logs and BLF objects into columns in one
   pass. See kernel.py. */

#include <stdint.h>
#include <string.h>

#define NAME_BYTES 64
#define NAMES_MAX 256
#define NOT_HEX 0x80

enum { EXTENDED = 1, REMOTE = 2, ERROR_FRAME = 4, FD = 8, BRS = 16, ESI = 32, TX = 64 };

typedef struct {
    int64_t *at_ns;
    uint32_t *identifier;
    uint8_t *flags, *channel, *length, *data;
    int64_t width; /* columns of data */
} Columns;

static uint8_t hex_of[256];

static void prepare(void)
{
    if (hex_of['1'] == 1)
        return;
    memset(hex_of, NOT_HEX, sizeof hex_of);
    for (int digit = 0; digit < 10; digit++)
        hex_of['0' + digit] = (uint8_t)digit;
    for (int digit = 10; digit < 16; digit++)
        hex_of['a' + digit - 10] = hex_of['A' + digit - 10] = (uint8_t)digit;
}

/* The number of `count` decimal digits, -1 if one of them is no digit. */
static int64_t decimal(const uint8_t *text, int count)
{
    int64_t value = 0;
    unsigned bad = 0;
    for (int at = 0; at < count; at++) {
        unsigned digit = (unsigned)text[at] - '0';
        bad |= digit > 9;
        value = value * 10 + digit;
    }
    return bad ? -1 : value;
}

typedef struct {
    char *names; /* NAMES_MAX * NAME_BYTES */
    int32_t *sizes;
    int32_t count, last;
} Names;

/* Index of another name than the last one, which is added if it is new; -1 if there is no room. */
static int other_name(Names *known, const uint8_t *name, int64_t size)
{
    for (int at = 0; at < known->count; at++)
        if (known->sizes[at] == size && !memcmp(known->names + at * NAME_BYTES, name, (size_t)size))
            return known->last = at;
    if (known->count == NAMES_MAX || size >= NAME_BYTES)
        return -1;
    memcpy(known->names + known->count * NAME_BYTES, name, (size_t)size);
    known->sizes[known->count] = (int32_t)size;
    return known->last = known->count++;
}

/* Index of a name. Nearly every line has the name of the line before: that way has no call. */
static inline int name_index(Names *known, const uint8_t *name, int64_t size)
{
    if (known->count && known->sizes[known->last] == size) {
        const char *last = known->names + known->last * NAME_BYTES;
        int64_t at = 0;
        while (at < size && (uint8_t)last[at] == name[at])
            at++;
        if (at == size)
            return known->last;
    }
    return other_name(known, name, size);
}

static int fd_length(int64_t length)
{
    return length <= 8 || length == 12 || length == 16 || length == 20 || length == 24
        || length == 32 || length == 48 || length == 64;
}

/* Converts hexadecimal pairs to bytes; 0 if a character is no digit. */
static int pairs(const uint8_t *text, int64_t count, uint8_t *out)
{
    unsigned bad = 0;
    for (int64_t at = 0; at < count; at++) {
        unsigned high = hex_of[text[2 * at]], low = hex_of[text[2 * at + 1]];
        bad |= high | low;
        out[at] = (uint8_t)(high << 4 | low);
    }
    return !(bad & NOT_HEX);
}

typedef struct {
    uint8_t text[10];
    int64_t value_ns;
} Second;

/* Parses one line without its end into row `row`; 0 if it needs the strict parser. */
static int line_to_row(const uint8_t *p, const uint8_t *end, Columns *out, int64_t row,
                       Names *names, Second *second)
{
    uint8_t bytes[64];
    if (end - p < 25 || p[0] != '(' || p[11] != '.')
        return 0;
    if (memcmp(p + 1, second->text, 10)) {
        int64_t value = decimal(p + 1, 10);
        if (value < 0 || value > 9223372034LL)
            return 0;
        memcpy(second->text, p + 1, 10);
        second->value_ns = value * 1000000000LL;
    }
    int digits = p[18] == ')' ? 6 : (end - p > 28 && p[21] == ')') ? 9 : 0;
    if (!digits)
        return 0;
    int64_t past_ns = decimal(p + 12, digits);
    if (past_ns < 0)
        return 0;
    past_ns *= digits == 6 ? 1000 : 1;
    p += 13 + digits;
    if (*p++ != ' ')
        return 0;
    const uint8_t *name = p;
    while (p < end && *p > 32)
        p++;
    if (p == name || p >= end || *p != ' ')
        return 0;
    int64_t name_size = p - name;
    p++;
    unsigned flags = 0, bad = 0;
    uint32_t identifier = 0;
    int id_digits = (end - p > 3 && p[3] == '#') ? 3 : (end - p > 8 && p[8] == '#') ? 8 : 0;
    if (!id_digits)
        return 0;
    for (int at = 0; at < id_digits; at++) {
        unsigned digit = hex_of[p[at]];
        bad |= digit;
        identifier = identifier << 4 | (digit & 15);
    }
    if (bad & NOT_HEX)
        return 0;
    if (id_digits == 3) {
        if (identifier > 0x7FF)
            return 0;
    } else if (identifier & 0x20000000u) {
        if (identifier > 0x3FFFFFFFu)
            return 0;
        flags = ERROR_FRAME;
        identifier &= 0x1FFFFFFFu;
    } else if (identifier > 0x1FFFFFFFu)
        return 0;
    else
        flags = EXTENDED;
    p += id_digits + 1;
    if (end - p >= 2 && end[-2] == ' ' && (end[-1] == 'R' || end[-1] == 'T')) {
        flags |= end[-1] == 'T' ? TX : 0;
        end -= 2;
    }
    int64_t most = 8;
    if (p < end && *p == '#') {
        if (end - p < 2 || hex_of[p[1]] & NOT_HEX || flags & ERROR_FRAME)
            return 0;
        unsigned bits = hex_of[p[1]];
        flags |= FD | (bits & 1 ? BRS : 0) | (bits & 2 ? ESI : 0);
        p += 2;
        most = 64;
    }
    int64_t length = (end - p) / 2;
    if ((end - p) & 1 || length > most || length > out->width || !fd_length(length))
        return 0;
    if (!pairs(p, length, bytes))
        return 0;
    int channel = name_index(names, name, name_size);
    if (channel < 0)
        return 0;
    memcpy(out->data + row * out->width, bytes, (size_t)length);
    out->at_ns[row] = second->value_ns + past_ns;
    out->identifier[row] = identifier;
    out->flags[row] = (uint8_t)flags;
    out->channel[row] = (uint8_t)channel;
    out->length[row] = (uint8_t)length;
    return 1;
}

/* Returns the number of rows, one for each line that is not empty, or -1 if there are more than
   `most`. `odd` receives row, start, end and line number of each row that needs the strict parser.
   `told` receives the number of such rows and of all lines. `data` must be zero before the call. */
int64_t canlog_candump(const uint8_t *text, int64_t size, int64_t width, int64_t most, int64_t *at_ns,
                       uint32_t *identifier, uint8_t *flags, uint8_t *channel, uint8_t *length,
                       uint8_t *data, char *name_texts, int32_t *name_sizes, int32_t *name_count,
                       int64_t *odd, int64_t *told)
{
    Columns out = {at_ns, identifier, flags, channel, length, data, width};
    Names names = {name_texts, name_sizes, *name_count, 0};
    Second second = {{0}, 0};
    int64_t row = 0, odds = 0, number = 0;
    prepare();
    for (const uint8_t *p = text, *last = text + size; p < last; number++) {
        const uint8_t *stop = memchr(p, '\n', (size_t)(last - p));
        const uint8_t *next = stop ? stop + 1 : last, *end = stop ? stop : last;
        if (end > p && end[-1] == '\r')
            end--;
        if (end > p) {
            if (row == most)
                return -1;
            if (!line_to_row(p, end, &out, row, &names, &second)) {
                int64_t *one = odd + 4 * odds++;
                one[0] = row, one[1] = p - text, one[2] = end - text, one[3] = number;
            }
            row++;
        }
        p = next;
    }
    *name_count = names.count;
    told[0] = odds;
    told[1] = number;
    return row;
}

/* A place in one line of text. */
typedef struct {
    const uint8_t *p, *end;
} Cursor;

static void skip_blanks(Cursor *at)
{
    while (at->p < at->end && (*at->p == ' ' || *at->p == '\t'))
        at->p++;
}

/* Returns the number of bytes up to the next blank or the end; `text` receives their start. */
static int64_t token(Cursor *at, const uint8_t **text)
{
    skip_blanks(at);
    *text = at->p;
    while (at->p < at->end && *at->p > ' ')
        at->p++;
    return at->p - *text;
}

/* A decimal number of units of 10^digits nanoseconds, for instance seconds with 9; -1 if malformed. */
static int64_t instant(const uint8_t *text, int64_t size, int digits)
{
    int64_t value = 0, at = 0;
    while (at < size && (unsigned)text[at] - '0' <= 9)
        value = value * 10 + (text[at++] - '0');
    if (!at || at > 9)
        return -1;
    int left = digits;
    if (at < size) {
        if (text[at++] != '.' || at == size || size - at > digits)
            return -1;
        for (; at < size; at++, left--) {
            unsigned digit = (unsigned)text[at] - '0';
            if (digit > 9)
                return -1;
            value = value * 10 + digit;
        }
    }
    while (left-- > 0)
        value *= 10;
    return value;
}

/* A hexadecimal number of at most 8 digits, -1 if malformed. */
static int64_t hexadecimal(const uint8_t *text, int64_t size)
{
    uint32_t value = 0;
    unsigned bad = 0;
    if (size < 1 || size > 8)
        return -1;
    for (int64_t at = 0; at < size; at++) {
        bad |= hex_of[text[at]];
        value = value << 4 | (hex_of[text[at]] & 15);
    }
    return bad & NOT_HEX ? -1 : (int64_t)value;
}

/* The number of one to three decimal digits, -1 if malformed. */
static int64_t small(const uint8_t *text, int64_t size)
{
    return size >= 1 && size <= 3 ? decimal(text, (int)size) : -1;
}

/* Index of the channel called `can` and these digits. */
static int channel_index(Names *names, const uint8_t *digits, int64_t size)
{
    uint8_t name[8] = "can";
    if (small(digits, size) < 0)
        return -1;
    memcpy(name + 3, digits, (size_t)size);
    return name_index(names, name, size + 3);
}

/* Parses `count` bytes of two hexadecimal digits each. */
static int spaced_bytes(Cursor *at, int64_t count, uint8_t *out)
{
    unsigned bad = 0;
    for (int64_t one = 0; one < count; one++) {
        skip_blanks(at);
        const uint8_t *p = at->p;
        if (at->end - p < 2 || (at->end - p > 2 && p[2] > ' '))
            return 0;
        unsigned high = hex_of[p[0]], low = hex_of[p[1]];
        bad |= high | low;
        out[one] = (uint8_t)(high << 4 | low);
        at->p = p + 2;
    }
    return !(bad & NOT_HEX);
}

static int put(Columns *out, int64_t row, int64_t at_ns, int64_t identifier, unsigned flags,
               int channel, int64_t length, const uint8_t *data)
{
    if (channel < 0 || length > out->width || identifier > (flags & EXTENDED ? 0x1FFFFFFF : 0x7FF))
        return 0;
    memcpy(out->data + row * out->width, data, (size_t)length);
    out->at_ns[row] = at_ns;
    out->identifier[row] = (uint32_t)identifier;
    out->flags[row] = (uint8_t)flags;
    out->channel[row] = (uint8_t)channel;
    out->length[row] = (uint8_t)length;
    return 1;
}

/* TX or 0 for a direction, -1 for any other word. */
static int direction(const uint8_t *text, int64_t size)
{
    if (size != 2 || text[1] != 'x')
        return -1;
    return text[0] == 'T' ? TX : text[0] == 'R' ? 0 : -1;
}

/* A hexadecimal ASC identifier, with a trailing x for 29 bits; -1 if malformed. */
static int64_t asc_identifier(const uint8_t *text, int64_t size, unsigned *flags)
{
    if (size > 1 && text[size - 1] == 'x') {
        *flags |= EXTENDED;
        size--;
    }
    return hexadecimal(text, size);
}

static int is_name(const uint8_t *text, int64_t size)
{
    unsigned bad = 0;
    for (int64_t at = 0; at < size; at++) {
        unsigned letter = text[at] | 0x20u, digit = (unsigned)text[at] - '0';
        bad |= !((letter >= 'a' && letter <= 'z' && text[at] < 128) || text[at] == '_' || (at && digit <= 9));
    }
    return !bad;
}

/* Parses the part after `CANFD`: channel, direction, identifier, an optional name, BRS, ESI, code,
   length and data. The third number after the data has the bits that identify the kind of frame. */
static int asc_fast(Cursor at, int64_t at_ns, Columns *out, int64_t row, Names *names)
{
    const uint8_t *text;
    uint8_t bytes[64];
    unsigned flags = 0;
    int64_t size = token(&at, &text);
    int channel = channel_index(names, text, size);
    size = token(&at, &text);
    int way = direction(text, size);
    if (channel < 0 || way < 0)
        return 0;
    size = token(&at, &text);
    int64_t identifier = asc_identifier(text, size, &flags);
    size = token(&at, &text);
    if (size && (text[0] < '0' || text[0] > '9')) {
        if (!is_name(text, size))
            return 0;
        size = token(&at, &text);
    }
    if (identifier < 0 || size != 1 || (text[0] != '0' && text[0] != '1'))
        return 0;
    int brs = text[0] == '1';
    size = token(&at, &text);
    if (size != 1 || (text[0] != '0' && text[0] != '1'))
        return 0;
    int esi = text[0] == '1';
    size = token(&at, &text);
    if (size != 1 || hex_of[text[0]] & NOT_HEX)
        return 0;
    size = token(&at, &text);
    int64_t length = size <= 2 ? small(text, size) : -1;
    if (length < 0 || length > 64 || !fd_length(length) || !spaced_bytes(&at, length, bytes))
        return 0;
    int64_t bits = -1;
    for (int number = 0; number < 3; number++) {
        size = token(&at, &text);
        if (number == 2 && size && (bits = hexadecimal(text, size)) < 0)
            return 0;
    }
    if (bits >= 0 && bits & 0x10)
        return 0;
    int fd = bits < 0 || bits & 0x1000 || length > 8 || (bits == 0 && (brs || esi));
    flags |= (unsigned)way | (fd ? FD | (brs ? BRS : 0) | (esi ? ESI : 0) : 0);
    return put(out, row, at_ns, identifier, flags, channel, length, bytes);
}

/* Parses an ASC frame with hexadecimal numbers; 0 if it needs the strict parser. */
static int asc_line(Cursor at, Columns *out, int64_t row, Names *names, const char *columns)
{
    const uint8_t *text;
    uint8_t bytes[64];
    unsigned flags = 0;
    (void)columns;
    int64_t size = token(&at, &text);
    int64_t at_ns = instant(text, size, 9);
    if (at_ns < 0)
        return 0;
    size = token(&at, &text);
    if (size == 5 && !memcmp(text, "CANFD", 5))
        return asc_fast(at, at_ns, out, row, names);
    const uint8_t *digits = text;
    int64_t digits_size = size;
    if (small(digits, digits_size) < 0)
        return 0;
    size = token(&at, &text);
    int64_t identifier = asc_identifier(text, size, &flags);
    size = token(&at, &text);
    int way = direction(text, size);
    if (identifier < 0 || way < 0 || token(&at, &text) != 1 || text[0] != 'd')
        return 0;
    if (token(&at, &text) != 1 || hex_of[text[0]] & NOT_HEX)
        return 0;
    int64_t length = hex_of[text[0]] < 8 ? hex_of[text[0]] : 8;
    if (!spaced_bytes(&at, length, bytes))
        return 0;
    skip_blanks(&at);
    if (at.p < at.end && (at.end - at.p < 9 || memcmp(at.p, "Length = ", 9)))
        return 0;
    int channel = channel_index(names, digits, digits_size);
    return put(out, row, at_ns, identifier, flags | (unsigned)way, channel, length, bytes);
}

static int64_t length_of_code(int64_t code)
{
    static const uint8_t lengths[] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
    return code < 0 || code > 15 ? -1 : lengths[code];
}

/* Parses a TRC data frame with the columns named in its head; 0 if it needs the strict parser. A
   lower-case v before them marks version 1, whose length is at most 8. */
static int trc_line(Cursor at, Columns *out, int64_t row, Names *names, const char *columns)
{
    const uint8_t *text, *digits = (const uint8_t *)"1";
    uint8_t bytes[64];
    unsigned flags = 0;
    int64_t at_ns = -1, identifier = -1, length = -1, code = -1, digits_size = 1, size;
    int first = *columns == 'v';
    for (columns += first; *columns; columns++) {
        size = token(&at, &text);
        if (!size)
            return 0;
        switch (*columns) {
        case 'N':
            if (size > 1 && text[size - 1] == ')')
                size--;
            if (size > 18 || decimal(text, (int)size) < 0)
                return 0;
            break;
        case 'O':
            at_ns = instant(text, size, 6);
            break;
        case 'T':
            if (size != 2)
                return 0;
            if (!memcmp(text, "FD", 2))
                flags |= FD;
            else if (!memcmp(text, "FB", 2))
                flags |= FD | BRS;
            else if (!memcmp(text, "FE", 2))
                flags |= FD | BRS | ESI;
            else if (!memcmp(text, "BI", 2))
                flags |= FD | ESI;
            else if (memcmp(text, "DT", 2))
                return 0;
            break;
        case 'B':
            digits = text, digits_size = size;
            break;
        case 'I':
            identifier = hexadecimal(text, size);
            flags |= size > 4 ? EXTENDED : 0;
            break;
        case 'd': {
            int way = direction(text, size);
            if (way < 0)
                return 0;
            flags |= (unsigned)way;
            break;
        }
        case 'l':
            length = small(text, size);
            break;
        case 'L':
            code = small(text, size);
            if (code < 0)
                return 0;
            break;
        case 'R':
            break;
        default:
            return 0;
        }
    }
    if (length < 0 && code >= 0)
        length = first ? code : flags & FD ? length_of_code(code) : code > 15 ? -1 : code < 8 ? code : 8;
    if (at_ns < 0 || identifier < 0 || length < 0 || length > (flags & FD ? 64 : 8))
        return 0;
    if (!spaced_bytes(&at, length, bytes))
        return 0;
    skip_blanks(&at);
    if (at.p < at.end)
        return 0;
    int channel = channel_index(names, digits, digits_size);
    return put(out, row, at_ns, identifier, flags, channel, length, bytes);
}

/* Same as canlog_candump for ASC, or with `columns` for TRC; stamps count from the start. */
int64_t canlog_text(const uint8_t *text, int64_t size, const char *columns, int64_t width,
                    int64_t most, int64_t *at_ns, uint32_t *identifier, uint8_t *flags,
                    uint8_t *channel, uint8_t *length, uint8_t *data, char *name_texts,
                    int32_t *name_sizes, int32_t *name_count, int64_t *odd, int64_t *told)
{
    Columns out = {at_ns, identifier, flags, channel, length, data, width};
    Names names = {name_texts, name_sizes, *name_count, 0};
    int64_t row = 0, odds = 0, number = 0;
    prepare();
    for (const uint8_t *p = text, *last = text + size; p < last; number++) {
        const uint8_t *stop = memchr(p, '\n', (size_t)(last - p));
        const uint8_t *next = stop ? stop + 1 : last;
        Cursor at = {p, stop ? stop : last};
        while (at.end > at.p && at.end[-1] <= ' ')
            at.end--;
        skip_blanks(&at);
        if (at.end > at.p) {
            if (row == most)
                return -1;
            int done = *columns ? trc_line(at, &out, row, &names, columns)
                                : asc_line(at, &out, row, &names, columns);
            if (!done) {
                int64_t *one = odd + 4 * odds++;
                one[0] = row, one[1] = at.p - text, one[2] = at.end - text, one[3] = number;
            }
            row++;
        }
        p = next;
    }
    *name_count = names.count;
    told[0] = odds;
    told[1] = number;
    return row;
}

static uint32_t u32(const uint8_t *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static uint64_t u64(const uint8_t *p)
{
    return (uint64_t)u32(p) | (uint64_t)u32(p + 4) << 32;
}

/* Receives the frames of BLF objects; kernel.py has the same structure. */
typedef struct {
    int64_t start_ns, most, rows, skipped;
    int64_t *at_ns;
    uint64_t *data;
    uint32_t *identifier;
    uint16_t *channel;
    uint8_t *flags, *length;
} Taken;

/* Takes one complete object with `p` at its signature; 0 if it needs the general reader. */
static int take_object(const uint8_t *p, int64_t object, Taken *out)
{
    uint32_t kind = u32(p + 12);
    if (kind != 1 && kind != 86) {
        if (kind == 2 || kind == 73 || kind == 100 || kind == 101 || kind == 104)
            return 0;
        out->skipped++;
        return 1;
    }
    if (p[4] != 32 || p[5] || object < 48 || out->rows == out->most)
        return 0;
    uint64_t stamp = u64(p + 24);
    unsigned bits = p[34], code = p[35] < 8 ? p[35] : 8;
    uint32_t wide = u32(p + 36);
    int64_t factor = u32(p + 16) == 1 ? 10000 : 1;
    if (stamp > (1ULL << 62) / 10000)
        return 0;
    if (!(wide >> 31) && (wide & 0x1FFFFFFFu) > 0x7FF)
        return 0;
    unsigned shown = bits & 0x80 ? 0 : code;
    uint64_t word = u64(p + 40);
    int64_t row = out->rows++;
    out->at_ns[row] = out->start_ns + (int64_t)stamp * factor;
    out->identifier[row] = wide & 0x1FFFFFFFu;
    out->flags[row] = (uint8_t)((wide >> 31) | (bits & 0x80 ? REMOTE : 0) | (bits & 1 ? TX : 0));
    out->channel[row] = (uint16_t)(p[32] | p[33] << 8);
    out->length[row] = (uint8_t)code;
    out->data[row] = shown == 8 ? word : word & ((1ULL << 8 * shown) - 1);
    return 1;
}

/* Takes at most `limit` objects from `at` on. Returns where the first incomplete object begins, or
   -1 if an object needs the general reader. */
static int64_t take_objects(const uint8_t *text, int64_t size, int64_t at, int64_t limit, Taken *out)
{
    for (; limit && size - at >= 16; limit--) {
        const uint8_t *p = text + at;
        int64_t skipped = 0;
        while (memcmp(p + skipped, "LOBJ", 4))
            if (++skipped > 4 || size - at - skipped < 16)
                return -1;
        p += skipped;
        int64_t object = u32(p + 8);
        if (object < 16)
            return -1;
        if (object > size - at - skipped)
            break;
        if (!take_object(p, object, out))
            return -1;
        at += skipped + object;
    }
    return at;
}

#define BORDER_BYTES 512

/* Takes the classic data frames of a container that holds no other frames and no damage. Returns
   where the first incomplete object begins. If the container needs the general reader, it takes
   nothing and returns -1. `rest` is what the containers before left over. */
int64_t canlog_blf(const uint8_t *rest, int64_t rest_size, const uint8_t *text, int64_t size,
                   Taken *out)
{
    int64_t before = out->rows, skipped = out->skipped, at = 0;
    if (rest_size) {
        /* The object that begins in the rest, and the start of the container, which may complete
           it. */
        uint8_t border[BORDER_BYTES];
        if (rest_size > BORDER_BYTES / 2)
            return -1;
        int64_t more = size < BORDER_BYTES - rest_size ? size : BORDER_BYTES - rest_size;
        memcpy(border, rest, (size_t)rest_size);
        memcpy(border + rest_size, text, (size_t)more);
        while (at < rest_size) {
            int64_t next = take_objects(border, rest_size + more, at, 1, out);
            if (next <= at) {
                out->rows = before;
                out->skipped = skipped;
                return -1;
            }
            at = next;
        }
        at -= rest_size;
    }
    at = take_objects(text, size, at, -1, out);
    if (at < 0) {
        out->rows = before;
        out->skipped = skipped;
    }
    return at > size ? size : at;
}

/* Walks records that each begin with one byte: the number of their group. `sizes` has the record
   size of each group, -1 if each record gives its own in four bytes, or -2 for an unknown number.
   `stop` receives where the first incomplete record begins, or -1 after a record of no group. */
int64_t canlog_records(const uint8_t *text, int64_t size, const int64_t *sizes, int64_t *places,
                       uint8_t *numbers, int64_t *stop)
{
    int64_t rows = 0, at = 0;
    while (at < size) {
        int64_t bytes = sizes[text[at]];
        if (bytes == -2) {
            at = -1;
            break;
        }
        if (bytes < 0) {
            if (size - at < 5)
                break;
            bytes = 4 + (int64_t)u32(text + at + 1);
        }
        if (bytes > size - at - 1)
            break;
        numbers[rows] = text[at];
        places[rows++] = at + 1;
        at += 1 + bytes;
    }
    *stop = at;
    return rows;
}

/* Decodes one signal of a column of words: bits `down` to `down + length`, then raw * scale +
   offset. It computes in integers modulo 2**64, or in doubles with two roundings. */
void canlog_integers(const uint64_t *words, int64_t count, int down, int length, int is_signed,
                     uint64_t scale, uint64_t offset, uint64_t *out)
{
    int up = 64 - down - length, right = 64 - length;
    if (is_signed)
        for (int64_t at = 0; at < count; at++)
            out[at] = (uint64_t)((int64_t)(words[at] << up) >> right) * scale + offset;
    else
        for (int64_t at = 0; at < count; at++)
            out[at] = ((words[at] << up) >> right) * scale + offset;
}

void canlog_doubles(const uint64_t *words, int64_t count, int down, int length, int is_signed,
                    double scale, double offset, double *out)
{
    int up = 64 - down - length, right = 64 - length;
    if (is_signed)
        for (int64_t at = 0; at < count; at++)
            out[at] = (double)((int64_t)(words[at] << up) >> right) * scale + offset;
    else if (length < 64)
        for (int64_t at = 0; at < count; at++)
            out[at] = (double)(int64_t)((words[at] << up) >> right) * scale + offset;
    else
        for (int64_t at = 0; at < count; at++)
            out[at] = (double)words[at] * scale + offset;
}

#define GROUPS_MAX 0xFFFF
#define SLOTS (1 << 17) /* more than twice the groups */

/* Numbers the pairs of channel and key of data frames in the order of their first frame. The
   channel stands above the 32 bits of the key, whose bit 31 marks an extended identifier. Returns
   how many there are, including `known` from earlier calls, or -1 for more than GROUPS_MAX - 1.
   `group` receives the number of each frame, GROUPS_MAX for frames without data. `keys` and
   `counts` have GROUPS_MAX places; `slots` begins as SLOTS zeros. */
int64_t canlog_number(const uint32_t *identifier, const uint8_t *flags, const uint8_t *channel,
                      int64_t count, uint16_t *group, int64_t known, uint64_t *keys,
                      int64_t *counts, uint16_t *slots)
{
    for (int64_t row = 0; row < count; row++) {
        if (flags[row] & (REMOTE | ERROR_FRAME)) {
            group[row] = GROUPS_MAX;
            continue;
        }
        uint64_t key = identifier[row] | (uint64_t)(flags[row] & EXTENDED) << 31
            | (uint64_t)channel[row] << 32;
        uint32_t slot = key < 0x800 ? (uint32_t)key : (uint32_t)(key * 0x9E3779B97F4A7C15u >> 47);
        while (slots[slot] && keys[slots[slot] - 1] != key)
            slot = (slot + 1) & (SLOTS - 1);
        if (!slots[slot]) {
            if (known == GROUPS_MAX - 1)
                return -1;
            keys[known] = key;
            counts[known] = 0;
            slots[slot] = (uint16_t)++known;
        }
        group[row] = (uint16_t)(slots[slot] - 1);
        counts[group[row]]++;
    }
    return known;
}

/* Sorts frames by group with a counting sort, and moves their columns along. `at` has the place of
   the next frame of each group; frames of group GROUPS_MAX are left out. */
void canlog_group(const uint16_t *group, int64_t count, int64_t *at, const int64_t *at_ns,
                  const uint64_t *words, const uint8_t *lengths, int64_t *out_ns,
                  uint64_t *out_words, uint8_t *out_lengths)
{
    for (int64_t row = 0; row < count; row++) {
        if (group[row] == GROUPS_MAX)
            continue;
        int64_t to = at[group[row]]++;
        out_ns[to] = at_ns[row];
        out_words[to] = words[row];
        out_lengths[to] = lengths[row];
    }
}

/* Writes the row numbers of the frames in sorted order; `first` is the number of the first row. */
void canlog_order(const uint16_t *group, int64_t count, int64_t first, int64_t *at, int64_t *order)
{
    for (int64_t row = 0; row < count; row++)
        if (group[row] != GROUPS_MAX)
            order[at[group[row]]++] = first + row;
}
