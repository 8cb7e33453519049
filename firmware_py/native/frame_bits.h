/* Length of a classic CAN data frame with an 11-bit identifier; buses/timing.py explains the tables. */
#ifndef FRAME_BITS_H
#define FRAME_BITS_H

#include <stdint.h>

#define INTERMISSION_BITS 3
#define LONGEST_FRAME_BITS 160

static uint8_t stuff_8[8 << 8], stuff_7[8 << 7];
static uint16_t crc_8[256];
static struct { uint8_t bits, state; uint16_t crc; } heads[2048][9];

static int stuff_step(int *state, int bit)
{
    int run = (*state & 3) + 1;
    run = *state >> 2 == bit ? run + 1 : 1;
    if (run == 5) {
        *state = (1 - bit) << 2;
        return 1;
    }
    *state = bit << 2 | (run - 1);
    return 0;
}

static int crc_step(int crc, int bit)
{
    return ((crc << 1) ^ ((crc >> 14 ^ bit) ? 0x4599 : 0)) & 0x7FFF;
}

static void fill_stuff_table(uint8_t *table, int width)
{
    for (int start = 0; start < 8; start++)
        for (int word = 0; word < 1 << width; word++) {
            int state = start, count = 0;
            for (int at = width - 1; at >= 0; at--)
                count += stuff_step(&state, word >> at & 1);
            table[start << width | word] = (uint8_t)(count << 3 | state);
        }
}

static void fill_frame_tables(void)
{
    fill_stuff_table(stuff_7, 7);
    fill_stuff_table(stuff_8, 8);
    for (int byte = 0; byte < 256; byte++) {
        int crc = 0;
        for (int at = 7; at >= 0; at--)
            crc = crc_step(crc, byte >> at & 1);
        crc_8[byte] = (uint16_t)crc;
    }
}

static void fill_head(unsigned id, unsigned length)
{
    /* Identifier, remote request, extension and reserved bit, length. */
    unsigned header = id << 7 | length;
    int state = 0, crc = 0, stuffed = 0;
    for (int at = 17; at >= 0; at--) {
        stuffed += stuff_step(&state, header >> at & 1);
        crc = crc_step(crc, header >> at & 1);
    }
    heads[id][length].bits = (uint8_t)(1 + 18 + stuffed + 8 * length + 15 + 10 + INTERMISSION_BITS);
    heads[id][length].state = (uint8_t)state;
    heads[id][length].crc = (uint16_t)crc;
}

/* Bits from start of frame to the end of the intermission. */
static int frame_bits(unsigned id, const uint8_t *data, unsigned length)
{
    if (!heads[id][length].bits)
        fill_head(id, length);
    int bits = heads[id][length].bits, state = heads[id][length].state, crc = heads[id][length].crc;
    for (unsigned at = 0; at < length; at++) {
        state = stuff_8[(state & 7) << 8 | data[at]];
        bits += state >> 3;
        crc = (crc << 8 & 0x7FFF) ^ crc_8[crc >> 7 ^ data[at]];
    }
    int high = stuff_7[(state & 7) << 7 | crc >> 8];
    int low = stuff_8[(high & 7) << 8 | (crc & 0xFF)];
    return bits + (high >> 3) + (low >> 3);
}

#endif
