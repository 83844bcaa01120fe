! Optimize: -O2
!> The linear subsystem of a structure over one step, exactly, as maps that are built once for each
!! step length.
!!
!! The subsystem is a sum of sections q_m'' + rate_m q_m' + square_m q_m = p_m; the deflections are
!! w_j = sum_m seen_mj q_m. The forces during a step are
!!
!!   p_m = sum_l pushed_ml f_l(t) + Im sum_k wave_mk exp(i nu_k t),
!!
!! with f_l the polynomials through their values at the Gauss nodes of the step (forces of elements,
!! columns of tables, whose cubics are exact for 4 nodes or more). `viscovib_section_step` gives
!! the response of each section.
module viscovib_modal_maps
  use viscovib_collocation, only: collocation_type
  use viscovib_kinds, only: wp
  use viscovib_pole_maps, only: new_pole_map, pole_map_type, poles_type
  use viscovib_quadrature, only: legendre_of_nodes
  use viscovib_section_step, only: driven_section, free_section, section_wave
  use viscovib_structure_kernels, only: mode_block
  implicit none
  private

  public :: modal_map_type, sections_type, new_modal_map

  type :: sections_type
    !> Shape (n), in maps padded to whole blocks of modes: squares of frequencies (1/s^2), and
    !! damping rates (1/s).
    real(wp), allocatable :: squares(:), rates(:)
    !> Deflections by modes, shape (n, n_seen); pushes of forces on modes, shape (n, n_pushed).
    real(wp), allocatable :: seen(:, :), pushed(:, :)
    !> Im sum_k waves(:,k) exp(i frequencies(k) t), shapes (n_waves) and (n, n_waves).
    real(wp), allocatable :: frequencies(:)
    complex(wp), allocatable :: waves(:, :)
    !> The part without real modes.
    type(poles_type) :: others
    !> Motion of the modes due to the base, shape (n); empty without base motion.
    real(wp), allocatable :: inner(:)
  end type sections_type

  type :: modal_map_type
    !> Gains of a section by its state (q, q') at the nodes and the end, shape (n, s+1), and of the
    !! section and its velocity at the end, shape (n, 4).
    real(wp), allocatable :: by_q(:, :), by_v(:, :), by_state(:, :)
    !> Gains of a section and its velocity at the end by a unit push at a node, shape (mode_block,
    !! s, n/mode_block, 2).
    real(wp), allocatable :: gain(:, :, :, :)
    !> Deflections at the nodes and the end by forces at the nodes, point p of deflection j at
    !! (j-1)(s+1)+p and node k of force l at (l-1)s+k.
    real(wp), allocatable :: answer(:, :)
    !> Response to harmonic loads with phase 0 at the start: deflections as above, sections at the
    !! end, their velocities, the part without real modes, and rates of massless variables; shape
    !! ((s+1) n_seen + 2 n + 2 n_poles + n_at_once, n_waves).
    complex(wp), allocatable :: swing(:, :)
    type(pole_map_type) :: poles
  end type modal_map_type

contains

  subroutine new_modal_map(map, sections, table, h)
    type(modal_map_type), intent(out) :: map
    type(sections_type), intent(in) :: sections
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h
    real(wp), allocatable :: gain(:, :)
    real(wp) :: coefficients(table%s, table%s, table%s + 1), by_order(table%s), rates(table%s)
    real(wp) :: by_q(2), by_v(2), now
    complex(wp) :: answer, velocity
    integer :: i, j, k, l, m, n, p, s, n_rows

    s = table%s
    n = size(sections%squares)
    n_rows = (s + 1)*size(sections%seen, 2)
    allocate (map%by_q(n, s + 1), map%by_v(n, s + 1), map%by_state(n, 4))
    allocate (map%gain(mode_block, s, n/mode_block, 2), gain(n, s))
    allocate (map%answer(n_rows, s*size(sections%pushed, 2)))
    allocate (map%swing(n_rows + 2*(n + size(sections%others%poles)) + sections%others%n_at_once, &
                        size(sections%frequencies)))
    map%swing = (0.0_wp, 0.0_wp)
    do p = 1, s + 1
      now = table%points(p)*h
      coefficients(:, :, p) = legendre_of_nodes(table%points(1:s), table%b, table%points(p))
      do m = 1, n
        associate (square => sections%squares(m)*now**2, rate => sections%rates(m)*now)
          call free_section(square, rate, by_q, by_v)
          map%by_q(m, p) = by_q(1)
          map%by_v(m, p) = now*by_v(1)
          call driven_section(square, rate, by_order, rates)
          gain(m, :) = now**2*matmul(by_order, coefficients(:, :, p))
          do k = 1, size(sections%frequencies)
            call section_wave(square, rate, sections%frequencies(k)*now, answer, velocity)
            answer = now**2*sections%waves(m, k)*answer
            do j = 1, size(sections%seen, 2)
              i = (j - 1)*(s + 1) + p
              map%swing(i, k) = map%swing(i, k) + sections%seen(m, j)*answer
            end do
            if (p <= s) cycle
            map%swing(n_rows + m, k) = answer
            map%swing(n_rows + n + m, k) = now*sections%waves(m, k)*velocity
          end do
        end associate
        if (p <= s) cycle
        map%by_state(m, :) = [map%by_q(m, p), map%by_v(m, p), by_q(2)/now, by_v(2)]
        i = modulo(m - 1, mode_block) + 1
        map%gain(i, :, (m - 1)/mode_block + 1, 1) = gain(m, :)
        map%gain(i, :, (m - 1)/mode_block + 1, 2) = now*matmul(rates, coefficients(:, :, p))
      end do
      do j = 1, size(sections%seen, 2)
        do l = 1, size(sections%pushed, 2)
          do k = 1, s
            map%answer((j - 1)*(s + 1) + p, (l - 1)*s + k) = &
              sum(sections%seen(:, j)*sections%pushed(:, l)*gain(:, k))
          end do
        end do
      end do
    end do
    call new_pole_map(map%poles, sections%others, sections%frequencies, coefficients, table, h, &
                      map%answer, map%swing)
  end subroutine new_modal_map

end module viscovib_modal_maps
