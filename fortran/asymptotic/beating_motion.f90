! Optimize: -O2 -fvect-cost-model=dynamic
!> Quasi-periodic motions under several loads: the attractors of modulation equations that are
!! not autonomous in any frame (`viscovib_beating_flow`), as motions of third order with lines.
!!
!! A product of generators rotates at the sum of their frequencies, and its amplitude beats. So the
!! motion is u = mean + sum_k Re X_k exp(i f_k t), where each f_k is an integer combination of the
!! frequencies of the frame and the loads. Terms of equal frequency form one line.
module viscovib_beating_motion
  use viscovib_beat_lattice, only: transform
  use viscovib_beating_flow, only: amplitudes_at, beating_flow_type, beats_found, find_beating_flow
  use viscovib_kinds, only: wp
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_polynomial_form, only: full_system_type, polynomial_form_type
  use viscovib_resonant_terms, only: far_influence, left_out, wants_more
  use viscovib_scales_error, only: motion_errors
  use viscovib_scales_motion, only: harmonic_of, n_sizes
  use viscovib_status, only: status_type
  implicit none
  private

  public :: beating_motion_type, find_beating_motion, beating_errors

  integer, parameter :: max_rounds = 3, max_carriers = 400
  !> Smallest line that is kept, relative to the largest of its coordinate.
  real(wp), parameter :: least_line = 1.0e-9_wp
  !> Frequencies that differ by less than this fraction of the highest natural one count as equal.
  real(wp), parameter :: same = 1.0e-9_wp
  real(wp), parameter :: two_pi = 6.283185307179586_wp
  !> Number of times at which the error of a motion is evaluated.
  integer, parameter :: n_knots = 400

  type :: beating_motion_type
    type(beating_flow_type) :: flow
    !> Frequencies of the lines, ascending, the mean first; X in the caller's units, shape
    !! (n_dof, n_lines).
    real(wp), allocatable :: frequency(:)
    complex(wp), allocatable :: x(:, :)
    !> Root mean square over the beats of each mode's |a|, with the phase of its largest term.
    complex(wp), allocatable :: typical(:)
    real(wp) :: sizes(n_sizes) = 0.0_wp, left_out = 0.0_wp
  end type beating_motion_type

contains

  !> The beating motion from given amplitudes at time 0; `scales` contains its equations.
  subroutine find_beating_motion(form, tolerance, start, known, scales, motion, status, cancel)
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: tolerance
    !> In natural units.
    complex(wp), intent(in) :: start(:)
    !> Motions found before, which are not computed again.
    type(beating_flow_type), intent(in) :: known(:)
    type(multiple_scales_type), intent(out) :: scales
    type(beating_motion_type), intent(out) :: motion
    type(status_type), intent(out) :: status
    integer, intent(inout) :: cancel
    real(wp), dimension(size(start)) :: expected, largest
    complex(wp) :: x(form%n_dof)
    integer :: round, j

    expected = abs(start)
    do round = 1, max_rounds
      call new_multiple_scales(scales, form, tolerance, .true., status, sizes=expected)
      if (status%failed()) return
      call find_beating_flow(scales%flow, start, known, motion%flow, cancel)
      if (motion%flow%outcome /= beats_found) return
      largest = largest_of(motion%flow)
      if (.not. (scales%normal%choosing .and. wants_more(scales%normal, largest))) exit
      expected = max(expected, largest)
    end do
    motion%left_out = max(left_out(scales%normal, largest), &
                          far_influence(scales%normal, scales%form, largest, .true.))
    call harmonic_of(scales, cmplx(largest, 0.0_wp, wp), 1.0_wp, x, motion%sizes)
    allocate (motion%typical(size(start)))
    do j = 1, size(start)
      associate (a => motion%flow%a(j, :))
        motion%typical(j) = norm2(abs(a))
        if (norm2(abs(a)) > 0.0_wp) then
          motion%typical(j) = norm2(abs(a))*a(maxloc(abs(a), 1))/maxval(abs(a))
        end if
      end associate
    end do
    call find_lines(scales, motion)
  end subroutine find_beating_motion

  !> Largest |a_j| over the grid of the beats.
  function largest_of(flow) result(largest)
    type(beating_flow_type), intent(in) :: flow
    real(wp) :: largest(size(flow%a, 1))
    complex(wp), allocatable :: a(:, :)
    integer :: j
    call on_grid(flow, a)
    do j = 1, size(largest)
      largest(j) = maxval(abs(a(:, j)))
    end do
  end function largest_of

  !> Amplitudes at the points of the grid, shape (n_points, n_modes).
  subroutine on_grid(flow, a)
    type(beating_flow_type), intent(in) :: flow
    complex(wp), allocatable, intent(out) :: a(:, :)
    integer :: i, j
    allocate (a(flow%lattice%n_points(), size(flow%a, 1)), source=(0.0_wp, 0.0_wp))
    do j = 1, size(flow%a, 1)
      do i = 1, size(flow%lattice%orders, 2)
        a(flow%lattice%place_of(flow%lattice%orders(:, i)), j) = flow%a(j, i)
      end do
      call transform(flow%lattice, a(:, j), .true.)
    end do
  end subroutine on_grid

  !> The Fourier terms of all products, as lines.
  subroutine find_lines(scales, motion)
    type(multiple_scales_type), intent(in) :: scales
    type(beating_motion_type), intent(inout) :: motion
    complex(wp), allocatable :: a(:, :), y(:, :), product(:), wave(:, :, :)
    real(wp) :: turn(2*scales%normal%n_generators), carrier(max_carriers)
    integer :: n, g, d, i, k, n_carriers
    logical :: moves(2*scales%normal%n_generators)

    call on_grid(motion%flow, a)
    associate (normal => scales%normal, form => scales%form)
      n = normal%n_modes
      g = normal%n_generators
      d = form%n_dof
      allocate (y(size(a, 1), 2*g), source=(1.0_wp, 0.0_wp))
      y(:, :n) = a
      y(:, g + 1:g + n) = conjg(a)
      turn(:n) = scales%flow%frame
      turn(n + 1:g) = form%drives(normal%hard)
      turn(g + 1:) = -turn(:g)
      moves = maxval(abs(y), 1) > 0.0_wp
      n_carriers = 0
      allocate (wave(size(a, 1), d, max_carriers), product(size(a, 1)))
      do i = 1, g
        ! The list contains the conjugates of products, but not the conjugates of single generators.
        if (moves(i)) call add(turn(i), y(:, i), normal%right(:d, i))
        if (moves(i)) call add(-turn(i), conjg(y(:, i)), conjg(normal%right(:d, i)))
      end do
      product = (1.0_wp, 0.0_wp)
      do i = 1, size(normal%weak)
        k = normal%weak(i)
        call add(form%drives(k), product, normal%u_load(:d, k))
        call add(-form%drives(k), product, conjg(normal%u_load(:d, k)))
      end do
      do i = 1, size(normal%used_pairs)
        associate (f => normal%pair(:, normal%used_pairs(i)))
          if (.not. all(moves(f))) cycle
          product = y(:, f(1))*y(:, f(2))
          call add(sum(turn(f)), product, normal%u_pair(:d, normal%used_pairs(i)))
        end associate
      end do
      do i = 1, size(normal%used_triples)
        associate (f => normal%triple(:, normal%used_triples(i)))
          if (.not. all(moves(f))) cycle
          product = y(:, f(1))*y(:, f(2))*y(:, f(3))
          call add(sum(turn(f)), product, normal%u_triple(:d, normal%used_triples(i)))
        end associate
      end do
      call collect(scales, motion, carrier(:n_carriers), wave)
    end associate

  contains

    subroutine add(frequency, values, u)
      real(wp), intent(in) :: frequency
      complex(wp), intent(in) :: values(:), u(:)
      integer :: c, row
      do c = 1, n_carriers
        if (abs(carrier(c) - frequency) <= same*maxval(turn)) exit
      end do
      if (c > max_carriers) return
      if (c > n_carriers) then
        n_carriers = c
        carrier(c) = frequency
        wave(:, :, c) = (0.0_wp, 0.0_wp)
      end if
      do row = 1, size(u)
        wave(:, row, c) = wave(:, row, c) + u(row)*values
      end do
    end subroutine add

  end subroutine find_lines

  !> Terms of all carriers, sorted by frequency; terms of equal frequency are added.
  subroutine collect(scales, motion, carrier, wave)
    type(multiple_scales_type), intent(in) :: scales
    type(beating_motion_type), intent(inout) :: motion
    real(wp), intent(in) :: carrier(:)
    complex(wp), intent(inout) :: wave(:, :, :)
    complex(wp) :: x(scales%form%n_dof, size(carrier)*size(motion%flow%lattice%orders, 2) + 1)
    real(wp) :: frequency(size(x, 2)), f, margin
    integer :: c, i, n, d, row, at, place
    logical :: kept(size(x, 2))

    d = scales%form%n_dof
    margin = same*maxval(scales%flow%frame)
    associate (lattice => motion%flow%lattice)
      n = 1
      frequency(1) = 0.0_wp
      x = (0.0_wp, 0.0_wp)
      do c = 1, size(carrier)
        do row = 1, d
          call transform(lattice, wave(:, row, c), .false.)
        end do
        do i = 1, size(lattice%orders, 2)
          f = carrier(c) + sum(lattice%orders(:, i)*lattice%beat)
          if (f < -margin) cycle
          at = lattice%place_of(lattice%orders(:, i))
          if (.not. any(abs(wave(at, :d, c)) > 0.0_wp)) cycle
          do place = 1, n
            if (abs(frequency(place) - f) <= margin) exit
          end do
          if (place > n) then
            n = place
            frequency(n) = f
          end if
          ! The mean is real: it is not doubled by a conjugate.
          x(:, place) = x(:, place) + merge(1.0_wp, 2.0_wp, place == 1)*wave(at, :d, c)
        end do
      end do
    end associate
    do row = 1, d
      x(row, :n) = scales%columns(row)*x(row, :n)
    end do
    x(:, 1) = x(:, 1) + scales%rest(:d)
    do i = 1, n
      kept(i) = i == 1 .or. any(abs(x(:, i)) > least_line*maxval(abs(x(:, 2:n)), 2))
    end do
    allocate (motion%frequency(count(kept(:n))), motion%x(d, count(kept(:n))))
    do place = 1, count(kept(:n))
      i = minloc(frequency(:n), 1, mask=kept(:n))
      kept(i) = .false.
      motion%frequency(place) = frequency(i)
      motion%x(:, place) = x(:, i)
    end do
  end subroutine collect

  !> The largest error of the motion in each coordinate, over some beats, after the decay of its
  !! initial transient.
  subroutine beating_errors(scales, full, motion, errors, cancel)
    type(multiple_scales_type), intent(in) :: scales
    !> As in `find_defect`.
    class(full_system_type), intent(in), optional :: full
    type(beating_motion_type), intent(in) :: motion
    !> In the caller's units, shape (n_dof).
    real(wp), intent(out) :: errors(:)
    integer, intent(inout) :: cancel
    complex(wp) :: a(size(motion%flow%a, 1), n_knots)
    real(wp) :: times(n_knots), each(size(errors), n_knots), span
    integer :: i, late

    span = 6.0_wp/minval(-real(scales%flow%s))
    if (motion%flow%lattice%d > 0) then
      associate (slowest => minval(motion%flow%lattice%beat(:motion%flow%lattice%d)))
        span = span + 2.0_wp*two_pi/slowest
      end associate
    end if
    ! Amplitudes are interpolated by cubics between the knots.
    span = min(span, 0.5_wp*n_knots/max(motion%flow%fastest, tiny(1.0_wp)))
    do i = 1, n_knots
      times(i) = span*(i - 1)/(n_knots - 1)
      a(:, i) = amplitudes_at(motion%flow, times(i))
    end do
    call motion_errors(scales, full, times, a, each, cancel)
    late = n_knots/2
    errors = maxval(each(:, late:), 2)
  end subroutine beating_errors

end module viscovib_beating_motion
