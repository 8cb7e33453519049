/* Implementation of radio.h: SHA-256, the envelope, and the few kinds of msgpack values it needs. */
#include "radio.h"

#include <string.h>

#define VERSION 3U
#define REPORT 1U
#define AUTHORITY 2U
#define STATUS 3U
#define ORDERS 4U
#define BODY_AT 26U
#define CODE_BYTES 16U
#define HASH_BYTES 32U
#define BLOCK_BYTES 64U
#define MESSAGE_BYTES_MAX 4096U
#define AUTHORITY_AGE_NS INT64_C(3000000000)
#define ORDERS_AGE_NS INT64_C(5000000000)
#define CHAINAGE_MAX_M 1e6
#define SPEED_MAX_MPS 200.0

/* SHA-256 */

struct hash {
    uint32_t state[8];
    uint8_t block[BLOCK_BYTES];
    uint64_t length;
};

static const uint32_t rounds[64] = {
    0x428a2f98U, 0x71374491U, 0xb5c0fbcfU, 0xe9b5dba5U, 0x3956c25bU, 0x59f111f1U, 0x923f82a4U,
    0xab1c5ed5U, 0xd807aa98U, 0x12835b01U, 0x243185beU, 0x550c7dc3U, 0x72be5d74U, 0x80deb1feU,
    0x9bdc06a7U, 0xc19bf174U, 0xe49b69c1U, 0xefbe4786U, 0x0fc19dc6U, 0x240ca1ccU, 0x2de92c6fU,
    0x4a7484aaU, 0x5cb0a9dcU, 0x76f988daU, 0x983e5152U, 0xa831c66dU, 0xb00327c8U, 0xbf597fc7U,
    0xc6e00bf3U, 0xd5a79147U, 0x06ca6351U, 0x14292967U, 0x27b70a85U, 0x2e1b2138U, 0x4d2c6dfcU,
    0x53380d13U, 0x650a7354U, 0x766a0abbU, 0x81c2c92eU, 0x92722c85U, 0xa2bfe8a1U, 0xa81a664bU,
    0xc24b8b70U, 0xc76c51a3U, 0xd192e819U, 0xd6990624U, 0xf40e3585U, 0x106aa070U, 0x19a4c116U,
    0x1e376c08U, 0x2748774cU, 0x34b0bcb5U, 0x391c0cb3U, 0x4ed8aa4aU, 0x5b9cca4fU, 0x682e6ff3U,
    0x748f82eeU, 0x78a5636fU, 0x84c87814U, 0x8cc70208U, 0x90befffaU, 0xa4506cebU, 0xbef9a3f7U,
    0xc67178f2U,
};

static uint32_t turned(uint32_t word, unsigned int places)
{
    return (word >> places) | (word << (32U - places));
}

static void hash_block(struct hash *hash)
{
    uint32_t words[64];
    uint32_t v[8];
    for (unsigned int at = 0U; at < 16U; at++) {
        const uint8_t *from = &hash->block[4U * at];
        words[at] = ((uint32_t)from[0] << 24U) | ((uint32_t)from[1] << 16U) |
                    ((uint32_t)from[2] << 8U) | from[3];
    }
    for (unsigned int at = 16U; at < 64U; at++) {
        const uint32_t a = words[at - 15U];
        const uint32_t b = words[at - 2U];
        words[at] = words[at - 16U] + words[at - 7U] +
                    (turned(a, 7U) ^ turned(a, 18U) ^ (a >> 3U)) +
                    (turned(b, 17U) ^ turned(b, 19U) ^ (b >> 10U));
    }
    (void)memcpy(v, hash->state, sizeof v);
    for (unsigned int at = 0U; at < 64U; at++) {
        const uint32_t one = v[7] + (turned(v[4], 6U) ^ turned(v[4], 11U) ^ turned(v[4], 25U)) +
                             ((v[4] & v[5]) ^ (~v[4] & v[6])) + rounds[at] + words[at];
        const uint32_t two = (turned(v[0], 2U) ^ turned(v[0], 13U) ^ turned(v[0], 22U)) +
                             ((v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]));
        for (unsigned int place = 7U; place > 0U; place--) {
            v[place] = v[place - 1U];
        }
        v[4] += one;
        v[0] = one + two;
    }
    for (unsigned int at = 0U; at < 8U; at++) {
        hash->state[at] += v[at];
    }
}

static void hash_start(struct hash *hash)
{
    static const uint32_t state[8] = {0x6a09e667U, 0xbb67ae85U, 0x3c6ef372U, 0xa54ff53aU,
                                      0x510e527fU, 0x9b05688cU, 0x1f83d9abU, 0x5be0cd19U};
    (void)memcpy(hash->state, state, sizeof state);
    hash->length = 0U;
}

static void hash_add(struct hash *hash, const uint8_t *data, size_t length)
{
    for (size_t at = 0U; at < length; at++) {
        hash->block[hash->length % BLOCK_BYTES] = data[at];
        hash->length++;
        if ((hash->length % BLOCK_BYTES) == 0U) {
            hash_block(hash);
        }
    }
}

static void hash_end(struct hash *hash, uint8_t code[HASH_BYTES])
{
    static const uint8_t one = 0x80U;
    static const uint8_t zero = 0U;
    const uint64_t bits = 8U * hash->length;
    uint8_t tail[8];
    for (unsigned int at = 0U; at < 8U; at++) {
        tail[at] = (uint8_t)((bits >> (56U - (8U * at))) & 0xFFU);
    }
    hash_add(hash, &one, 1U);
    while ((hash->length % BLOCK_BYTES) != 56U) {
        hash_add(hash, &zero, 1U);
    }
    hash_add(hash, tail, sizeof tail);
    for (unsigned int at = 0U; at < HASH_BYTES; at++) {
        code[at] = (uint8_t)((hash->state[at / 4U] >> (24U - (8U * (at % 4U)))) & 0xFFU);
    }
}

void radio_hmac(const uint8_t key[RADIO_KEY_MAX], const uint8_t *data, size_t length,
                uint8_t code[HASH_BYTES])
{
    struct hash hash;
    uint8_t pad[BLOCK_BYTES];
    uint8_t inner[HASH_BYTES];
    for (unsigned int at = 0U; at < BLOCK_BYTES; at++) {
        pad[at] = (uint8_t)(key[at] ^ 0x36U);
    }
    hash_start(&hash);
    hash_add(&hash, pad, sizeof pad);
    hash_add(&hash, data, length);
    hash_end(&hash, inner);
    for (unsigned int at = 0U; at < BLOCK_BYTES; at++) {
        pad[at] = (uint8_t)(key[at] ^ 0x5CU);
    }
    hash_start(&hash);
    hash_add(&hash, pad, sizeof pad);
    hash_add(&hash, inner, sizeof inner);
    hash_end(&hash, code);
}

/* Writing */

struct writer {
    uint8_t *bytes;
    size_t at;
};

static void put_number(struct writer *to, uint64_t value, unsigned int bytes)
{
    for (unsigned int at = bytes; at > 0U; at--) {
        to->bytes[to->at] = (uint8_t)((value >> (8U * (at - 1U))) & 0xFFU);
        to->at++;
    }
}

static void put_int(struct writer *to, uint64_t value)
{
    put_number(to, 0xCFU, 1U);
    put_number(to, value, 8U);
}

static void put_bool(struct writer *to, bool value)
{
    put_number(to, value ? 0xC3U : 0xC2U, 1U);
}

static void put_float(struct writer *to, double value)
{
    uint64_t bits;
    (void)memcpy(&bits, &value, sizeof bits);
    put_number(to, 0xCBU, 1U);
    put_number(to, bits, 8U);
}

static void put_head(struct writer *to, const struct radio *radio, uint8_t type,
                     uint32_t sequence, int64_t now_ns)
{
    put_number(to, VERSION, 1U);
    put_number(to, type, 1U);
    put_number(to, radio->train, 2U);
    put_number(to, 0U, 2U); /* The wayside has the address 0. */
    put_number(to, sequence, 4U);
    put_number(to, (uint64_t)now_ns, 8U);
    put_number(to, radio->database, 8U);
}

static size_t seal(struct writer *to, const struct radio *radio)
{
    uint8_t code[HASH_BYTES];
    radio_hmac(radio->key, to->bytes, to->at, code);
    (void)memcpy(&to->bytes[to->at], code, CODE_BYTES);
    return to->at + CODE_BYTES;
}

size_t radio_write_report(struct radio *radio, const struct radio_report *report, int64_t now_ns,
                          uint8_t bytes[RADIO_BYTES_MAX])
{
    struct writer to = {bytes, 0U};
    radio->reports++;
    put_head(&to, radio, REPORT, radio->reports, now_ns);
    put_number(&to, 0x97U, 1U); /* An array of seven. */
    put_int(&to, radio->boot);
    put_float(&to, report->front_min_m);
    put_float(&to, report->front_max_m);
    put_float(&to, report->rear_min_m);
    put_float(&to, report->speed_mps);
    put_bool(&to, report->standstill);
    put_int(&to, radio->parameters);
    return seal(&to, radio);
}

size_t radio_write_status(struct radio *radio, const struct radio_status *status, int64_t now_ns,
                          uint8_t bytes[RADIO_BYTES_MAX])
{
    struct writer to = {bytes, 0U};
    radio->statuses++;
    put_head(&to, radio, STATUS, radio->statuses, now_ns);
    put_number(&to, 0x9FU, 1U); /* An array of fifteen. */
    put_int(&to, radio->boot);
    put_int(&to, status->mode);
    put_int(&to, status->supervision);
    put_int(&to, status->cause);
    put_bool(&to, status->localised);
    put_bool(&to, status->standstill);
    put_float(&to, status->front_m);
    put_bool(&to, status->doors_locked);
    put_bool(&to, status->open_left);
    put_bool(&to, status->open_right);
    put_bool(&to, status->passenger_alarm);
    put_bool(&to, status->fire);
    put_bool(&to, status->obstacle);
    put_bool(&to, status->alarm_raised);
    put_int(&to, status->emergency_number);
    return seal(&to, radio);
}

/* Reading */

struct reader {
    const uint8_t *bytes;
    size_t at;
    size_t length;
    bool good; /* Every value up to now was there and of its type. */
};

static uint64_t get_number(struct reader *from, unsigned int bytes)
{
    uint64_t value = 0U;
    from->good = from->good && ((from->length - from->at) >= bytes);
    for (unsigned int at = 0U; from->good && (at < bytes); at++) {
        value = (value << 8U) | from->bytes[from->at];
        from->at++;
    }
    return value;
}

static uint64_t get_int(struct reader *from)
{
    const uint64_t type = get_number(from, 1U);
    uint64_t value = type;
    if (type > 0x7FU) {
        from->good = from->good && (type >= 0xCCU) && (type <= 0xCFU);
        value = from->good ? get_number(from, 1U << (unsigned int)(type - 0xCCU)) : 0U;
    }
    return value;
}

static bool get_bool(struct reader *from)
{
    const uint64_t type = get_number(from, 1U);
    from->good = from->good && ((type == 0xC2U) || (type == 0xC3U));
    return type == 0xC3U;
}

static double get_float(struct reader *from, double least, double most)
{
    double value = 0.0;
    if ((from->at < from->length) && (from->bytes[from->at] == 0xCBU)) {
        const uint64_t type = get_number(from, 1U);
        const uint64_t bits = get_number(from, 8U);
        (void)type;
        (void)memcpy(&value, &bits, sizeof value);
    } else {
        value = (double)get_int(from);
    }
    from->good = from->good && (value >= least) && (value <= most);
    return value;
}

static uint32_t get_array(struct reader *from, uint32_t most)
{
    const uint64_t type = get_number(from, 1U);
    uint64_t count = type & 0x0FU;
    if (type == 0xDCU) {
        count = get_number(from, 2U);
    } else {
        from->good = from->good && ((type & 0xF0U) == 0x90U);
    }
    from->good = from->good && (count <= most);
    return from->good ? (uint32_t)count : 0U;
}

static bool is_of_age(int64_t echo_ns, int64_t now_ns, int64_t most_ns)
{
    return (echo_ns >= 0) && (echo_ns <= now_ns) && ((now_ns - echo_ns) <= most_ns);
}

/* Whether the authority may be used: for this train and incarnation, newer than the held one. */
static bool take_authority(struct radio *radio, struct reader *from, uint32_t sequence,
                           int64_t now_ns)
{
    struct radio_authority heard = {0};
    const uint32_t fields = get_array(from, 6U);
    const uint64_t boot = get_int(from);
    bool good;
    heard.term = get_int(from);
    heard.echo_ns = (int64_t)get_int(from);
    heard.end_m = get_float(from, -CHAINAGE_MAX_M, CHAINAGE_MAX_M);
    if ((from->at < from->length) && (from->bytes[from->at] == 0xC0U)) {
        from->at++; /* No protection behind the train. */
    } else {
        (void)get_float(from, -CHAINAGE_MAX_M, CHAINAGE_MAX_M);
    }
    good = (get_int(from) == radio->parameters) && from->good && (from->at == from->length) &&
           (fields == 6U) && (boot == radio->boot) &&
           is_of_age(heard.echo_ns, now_ns, AUTHORITY_AGE_NS);
    if (good && radio->authority.held) {
        good = (heard.term > radio->authority.term) ||
               ((heard.term == radio->authority.term) && (sequence > radio->authority.sequence));
    }
    if (good) {
        heard.held = true;
        heard.sequence = sequence;
        radio->authority = heard;
    }
    return good;
}

static void get_restrictions(struct reader *from, struct radio_orders *orders)
{
    orders->restriction_count = get_array(from, RADIO_RESTRICTIONS_MAX);
    for (uint32_t at = 0U; at < orders->restriction_count; at++) {
        struct radio_restriction *each = &orders->restrictions[at];
        const uint32_t fields = get_array(from, 3U);
        each->start_m = get_float(from, -CHAINAGE_MAX_M, CHAINAGE_MAX_M);
        each->end_m = get_float(from, each->start_m, CHAINAGE_MAX_M);
        each->limit_mps = get_float(from, 0.0, SPEED_MAX_MPS);
        from->good = from->good && (fields == 3U) && (each->limit_mps > 0.0);
    }
}

static bool take_orders(struct radio *radio, struct reader *from, uint32_t sequence,
                        int64_t now_ns)
{
    struct radio_orders heard = {0};
    const uint32_t fields = get_array(from, 15U);
    const uint64_t boot = get_int(from);
    bool good;
    heard.echo_ns = (int64_t)get_int(from);
    heard.awake = get_bool(from);
    heard.hold = get_bool(from);
    (void)get_bool(from); /* Skip the next station: not done by this controller. */
    (void)get_bool(from); /* Stop at the next station: it stops at each of its mission. */
    heard.emergency = get_bool(from);
    (void)get_int(from); /* Releases of an emergency: only the desk resets this controller. */
    (void)get_bool(from); /* Creep: not done. */
    (void)get_bool(from); /* Restricted: not done. */
    heard.doors_left = get_bool(from);
    heard.doors_right = get_bool(from);
    heard.platform_doors_locked = get_bool(from);
    get_restrictions(from, &heard);
    (void)get_int(from); /* The emergency that a release is for. */
    good = from->good && (from->at == from->length) && (fields == 15U) &&
           (boot == radio->boot) && is_of_age(heard.echo_ns, now_ns, ORDERS_AGE_NS) &&
           (!radio->orders.held || (sequence > radio->orders.sequence));
    if (good) {
        heard.held = true;
        heard.sequence = sequence;
        radio->orders = heard;
    }
    return good;
}

static bool is_sealed(const struct radio *radio, const uint8_t *data, size_t length)
{
    uint8_t code[HASH_BYTES];
    uint8_t difference = 0U;
    radio_hmac(radio->key, data, length - CODE_BYTES, code);
    for (unsigned int at = 0U; at < CODE_BYTES; at++) {
        difference |= (uint8_t)(code[at] ^ data[(length - CODE_BYTES) + at]);
    }
    return difference == 0U;
}

void radio_take(struct radio *radio, const uint8_t *data, size_t length, int64_t now_ns)
{
    bool good = (length > (BODY_AT + CODE_BYTES)) && (length <= MESSAGE_BYTES_MAX) &&
                is_sealed(radio, data, length);
    if (good) {
        struct reader from = {data, 0U, length - CODE_BYTES, true};
        const uint64_t version = get_number(&from, 1U);
        const uint64_t type = get_number(&from, 1U);
        const uint64_t source = get_number(&from, 2U);
        const uint64_t destination = get_number(&from, 2U);
        const uint32_t sequence = (uint32_t)get_number(&from, 4U);
        (void)get_number(&from, 8U); /* The sender's clock: no decision uses it. */
        good = (get_number(&from, 8U) == radio->database) && (version == VERSION) &&
               (source == 0U) && (destination == radio->train);
        if (good && (type == AUTHORITY)) {
            good = take_authority(radio, &from, sequence, now_ns);
        } else if (good && (type == ORDERS)) {
            good = take_orders(radio, &from, sequence, now_ns);
        } else {
            good = false;
        }
    }
    radio->refused += good ? 0U : 1U;
}
