!> Floquet multipliers of motions with laws that kink or jump and elements with states, also with
!! sums of exponentials.
!!
!! Perturbations (`viscovib_kinked_motion`) are integrated between the phases at which a law changes
!! its branch. On each piece Y' = A(t) Y is solved at the sixteen Gauss points, Y = Y_0 + integral
!! of A Y, by iteration. A piece that sixteen points do not resolve is halved. With piecewise linear
!! laws, such as a gap, A is constant on a piece, and Y = exp(A t) Y_0 by its series. A jump is
!! applied as a separate map (`viscovib_jump_maps`).
module viscovib_kinked_stability
  use viscovib_constants, only: pi
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_gauss_points, only: points_16, weights_16
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_jump_maps, only: find_jumps, jump_map
  use viscovib_kinds, only: wp
  use viscovib_kinked_motion, only: element_along, linear_rest, new_rest, prepare_elements
  use viscovib_oscillator, only: oscillator_type
  use viscovib_phase_panels, only: is_resolved, longest_panel, motion_at, new_panel, nodes, &
                                   panel_type, wave_sum
  use viscovib_phase_roots, only: phase_list
  use viscovib_polynomial, only: polynomial_type
  use viscovib_sorting, only: sort_falling
  implicit none
  private

  public :: kinked_multipliers

  !> Largest phase angle of the fastest mode in a piece; tolerance, iterations, and pieces.
  real(wp), parameter :: angle_a_piece = 1.5_wp, settled = 1.0e-14_wp
  integer, parameter :: most_turns = 60, most_pieces = 4000
  !> Limits of the exponential series: number of terms, and their size; beyond it they cancel.
  integer, parameter :: most_terms = 30
  real(wp), parameter :: largest_term = 1.0e12_wp

contains

  !> Multipliers over a period, or -1 times the half-period ones (half-wave), largest first.
  subroutine kinked_multipliers(system, set, nu, x, roots, found, jumps)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    !> Frequency (rad/s); harmonics, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: nu, x(:, :)
    complex(wp), allocatable, intent(out) :: roots(:)
    !> False if the linear subsystem is too large or has no real modes, or if the motion slides on a
    !! surface where a law jumps.
    logical, intent(out) :: found
    !> True if a law jumps along the motion; no other method here treats this.
    logical, intent(out) :: jumps
    type(linear_rest) :: rest
    type(element_along), allocatable :: elements(:)
    type(phase_list) :: breaks
    real(wp), allocatable :: y(:, :)
    real(wp) :: integral(nodes, nodes), from, to, ending, length, longest
    integer :: i, n, pieces
    type(jump_map), allocatable :: maps(:)
    logical :: done, known

    call find_jumps(system, set, x, set%orders*nu, maps, known)
    jumps = size(maps) > 0
    call new_rest(rest, system, found)
    if (.not. found) return
    if (jumps) call find_jumps(system, set, x, set%orders*nu, maps, known, rest)
    found = known .and. .not. (jumps .and. size(rest%remembers) > 0)
    if (.not. found) return
    call prepare_elements(system, set, x, set%orders*nu, elements, breaks)
    n = size(rest%a, 1)
    do i = 1, size(elements)
      n = n + size(elements(i)%z)
    end do
    allocate (y(n, n), source=0.0_wp)
    do i = 1, n
      y(i, i) = 1.0_wp
    end do
    call integration(integral)
    ending = merge(pi, 2.0_wp*pi, set%half_wave)
    longest = min(longest_panel(set), angle_a_piece*nu/rest%fastest)
    pieces = 0
    from = 0.0_wp
    do i = 1, breaks%n + 1
      to = ending
      if (i <= breaks%n) to = min(breaks%theta(i), ending)
      call pass_jumps(maps, from, y)
      length = (to - from)/max(1, ceiling((to - from)/longest))
      do while (to - from > 8.0_wp*epsilon(1.0_wp)*ending)
        length = min(length, to - from)
        pieces = pieces + 1
        found = pieces <= most_pieces
        if (.not. found) return
        call one_piece(system, set, nu, x, rest, elements, integral, from, from + length, &
                       length <= 1.0e-4_wp*longest, y, done)
        if (.not. done) then
          length = 0.5_wp*length
          cycle
        end if
        from = from + length
        length = (to - from)/max(1, ceiling((to - from)/min(longest, 2.0_wp*length)))
      end do
      from = to
    end do
    call take_roots(y, size(rest%a, 1), elements, set%half_wave, roots, found)
  end subroutine kinked_multipliers

  !> Apply the jumps at a phase, each of them once.
  subroutine pass_jumps(maps, theta, y)
    type(jump_map), intent(inout) :: maps(:)
    real(wp), intent(in) :: theta
    real(wp), intent(inout) :: y(:, :)
    integer :: i, n
    do i = 1, size(maps)
      if (maps(i)%done .or. abs(maps(i)%theta - theta) > 1.0e-12_wp) cycle
      n = size(maps(i)%s, 1)
      y(:n, :) = matmul(maps(i)%s, y(:n, :))
      maps(i)%done = .true.
    end do
  end subroutine pass_jumps

  !> Integrals from 0 to each point of the Lagrange polynomials of all points.
  pure subroutine integration(integral)
    real(wp), intent(out) :: integral(:, :)
    real(wp) :: legendre(nodes, 0:nodes), x(nodes)
    integer :: i, j, k

    x = 2.0_wp*points_16 - 1.0_wp
    legendre(:, 0) = 1.0_wp
    legendre(:, 1) = x
    do k = 1, nodes - 1
      legendre(:, k + 1) = ((2*k + 1)*x*legendre(:, k) - k*legendre(:, k - 1))/(k + 1)
    end do
    do j = 1, nodes
      do i = 1, nodes
        integral(i, j) = x(i) + 1.0_wp
        do k = 1, nodes - 1
          integral(i, j) = integral(i, j) + legendre(j, k)*(legendre(i, k + 1) - legendre(i, k - 1))
        end do
        integral(i, j) = 0.5_wp*weights_16(j)*integral(i, j)
      end do
    end do
  end subroutine integration

  !> Integrate the perturbations over one piece, unless sixteen points do not resolve them.
  subroutine one_piece(system, set, nu, x, rest, elements, integral, from, to, last, y, done)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: nu, x(:, :), integral(:, :), from, to
    type(linear_rest), intent(in) :: rest
    type(element_along), intent(inout) :: elements(:)
    !> True if the piece is accepted without a further check.
    logical, intent(in) :: last
    real(wp), intent(inout) :: y(:, :)
    logical, intent(out) :: done
    real(wp), dimension(size(y, 1), size(y, 2), nodes) :: stage, slope, next
    real(wp) :: a(size(y, 1), size(y, 1), nodes), kept(size(y, 1), size(elements)), &
                places(size(elements)), entry(nodes), size_of, h
    integer :: i, j, k, turn

    do i = 1, size(elements)
      kept(:size(elements(i)%z), i) = elements(i)%z
      places(i) = elements(i)%at
    end do
    call matrices(system, set, nu, x, rest, elements, from, to, a, y)
    h = (to - from)/nu
    if (is_constant(a)) then
      call along_exponential(h*a(:, :, 1), y, done)
      if (done) then
        call to_end(set, elements, to)
        return
      end if
    end if
    do i = 1, nodes
      stage(:, :, i) = y
    end do
    done = .false.
    do turn = 1, most_turns
      do i = 1, nodes
        slope(:, :, i) = h*matmul(a(:, :, i), stage(:, :, i))
      end do
      do i = 1, nodes
        next(:, :, i) = y
        do k = 1, nodes
          next(:, :, i) = next(:, :, i) + integral(i, k)*slope(:, :, k)
        end do
      end do
      size_of = maxval(abs(next))
      done = maxval(abs(next - stage)) <= settled*size_of
      stage = next
      if (done) exit
    end do
    if (done .and. .not. last) then
      do j = 1, size(y, 2)
        do k = 1, size(y, 1)
          entry = slope(k, j, :)
          if (done) done = is_resolved(entry, size_of)
        end do
      end do
    end if
    done = done .or. last
    if (.not. done) then
      do i = 1, size(elements)
        elements(i)%z = kept(:size(elements(i)%z), i)
        elements(i)%at = places(i)
      end do
      return
    end if
    do k = 1, nodes
      y = y + weights_16(k)*slope(:, :, k)
    end do
    call to_end(set, elements, to)
  end subroutine one_piece

  !> True if the equations are the same at all points.
  pure logical function is_constant(a)
    real(wp), intent(in) :: a(:, :, :)
    integer :: i
    is_constant = .false.
    do i = 2, size(a, 3)
      if (any(abs(a(:, :, i) - a(:, :, 1)) > 0.0_wp)) return
    end do
    is_constant = .true.
  end function is_constant

  !> y becomes exp(a) y, unless the series needs too many terms.
  pure subroutine along_exponential(a, y, done)
    real(wp), intent(in) :: a(:, :)
    real(wp), intent(inout) :: y(:, :)
    logical, intent(out) :: done
    real(wp), dimension(size(y, 1), size(y, 2)) :: term, total
    integer :: k

    term = y
    total = y
    do k = 1, most_terms
      term = matmul(a, term)/k
      total = total + term
      done = maxval(abs(term)) <= settled*maxval(abs(total))
      if (done .or. maxval(abs(term)) > largest_term*maxval(abs(y))) exit
    end do
    if (done) y = total
  end subroutine along_exponential

  !> Advance the elements from the last point to the end of a piece.
  subroutine to_end(set, elements, theta)
    type(harmonic_set_type), intent(in) :: set
    type(element_along), intent(inout) :: elements(:)
    real(wp), intent(in) :: theta
    real(wp) :: d, work
    integer :: i

    do i = 1, size(elements)
      associate (one => elements(i))
        d = wave_sum(set, one%d, theta)
        block
          real(wp), dimension(size(one%z)) :: by_z, by_change
          call one%element%advance(d - one%at, one%z, by_z, by_change, work)
        end block
        one%at = d
      end associate
    end do
  end subroutine to_end

  !> A(t) at the points; advances the elements, and sets perturbations of states that begin to slide
  !! to 0.
  subroutine matrices(system, set, nu, x, rest, elements, from, to, a, y)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: nu, x(:, :), from, to
    type(linear_rest), intent(in) :: rest
    type(element_along), intent(inout) :: elements(:)
    real(wp), intent(out) :: a(:, :, :)
    real(wp), intent(inout) :: y(:, :)
    type(panel_type) :: panel
    real(wp) :: u(nodes, size(x, 2) + system%n_rates()), turned(size(x, 1))
    real(wp) :: slopes(nodes, system%n_memory(), size(u, 2)), s(size(x, 2), size(x, 2))
    integer :: b, i, j, n

    call new_panel(panel, set, from, to)
    do b = 1, size(x, 2)
      u(:, b) = motion_at(panel, x(:, b))
    end do
    do b = 1, system%n_rates()
      turned(1::2) = -set%orders*nu*x(2::2, system%rates(b))
      turned(2::2) = set%orders*nu*x(1::2, system%rates(b))
      u(:, size(x, 2) + b) = motion_at(panel, turned)
    end do
    slopes = 0.0_wp
    if (any(system%bent)) call system%deflection_slopes(u, slopes)
    n = size(rest%a, 1)
    a = 0.0_wp
    do i = 1, nodes
      s = matmul(system%spread, slopes(i, :, :size(x, 2)))
      a(:n, :n, i) = rest%a - matmul(rest%b, matmul(s, rest%y))
      do b = 1, system%n_rates()
        associate (by_rate => matmul(rest%b, matmul(system%spread, slopes(i, :, size(x, 2) + b))))
          do j = 1, n
            a(:n, j, i) = a(:n, j, i) - by_rate*rest%rate(system%rates(b), j)
          end do
        end associate
      end do
      do j = 1, size(rest%remembers)
        associate (row => a(n - size(rest%remembers) + j, :n, i), &
                   by => slopes(i, rest%remembers(j), :))
          row = row + matmul(by(:size(x, 2)), rest%y)
          if (system%n_rates() > 0) row = row + matmul(by(size(x, 2) + 1:), &
                                                       rest%rate(system%rates, :))
        end associate
      end do
    end do
    do i = 1, size(elements)
      call add_element(system, panel, set, nu, rest, elements(i), n, a, y)
      n = n + size(elements(i)%z)
    end do
  end subroutine matrices

  !> Add the contribution of one element; its states follow the first n.
  subroutine add_element(system, panel, set, nu, rest, one, n, a, y)
    class(oscillator_type), intent(in) :: system
    type(panel_type), intent(in) :: panel
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: nu
    type(linear_rest), intent(in) :: rest
    type(element_along), intent(inout) :: one
    integer, intent(in) :: n
    real(wp), intent(inout) :: a(:, :, :), y(:, :)
    real(wp), dimension(size(one%z)) :: slopes, by_z, by_change, by_state
    real(wp) :: d(nodes), v(nodes), turned(size(one%d)), work, elastic
    real(wp) :: on(size(rest%a, 1)), read_by(size(rest%a, 1)), rate_by(size(rest%a, 1))
    integer :: i, j, way

    d = motion_at(panel, one%d)
    turned(1::2) = -set%orders*nu*one%d(2::2)
    turned(2::2) = set%orders*nu*one%d(1::2)
    v = motion_at(panel, turned)
    way = merge(1, -1, v(nodes/2) >= 0.0_wp)
    select type (system)
    class is (polynomial_type)
      associate (law => system%laws(one%law))
        on = 0.0_wp
        do j = 1, size(law%equations)
          on = on + rest%b(:, law%equations(j))*law%weights(j)
        end do
        read_by = matmul(law%arguments(1, :), rest%y)
        rate_by = matmul(law%arguments(1, :), rest%rate)
      end associate
    end select
    do i = 1, nodes
      call one%element%advance(d(i) - one%at, one%z, by_z, by_change, work)
      one%at = d(i)
      call one%element%slope(one%z, way, slopes, by_z)
      if (i == 1) then
        do j = 1, size(one%z)
          if (.not. abs(slopes(j)) > 0.0_wp .and. .not. abs(by_z(j)) > 0.0_wp) y(n + j, :) = 0.0_wp
        end do
      end if
      by_state = merge(0.0_wp, one%element%weight, one%sticks)
      elastic = one%element%elastic - one%element%stiffness_at_rest() &
                + sum(one%element%weight*slopes, one%sticks)
      do j = 1, size(on)
        a(:size(on), j, i) = a(:size(on), j, i) - elastic*on*read_by(j)
      end do
      do j = 1, size(one%z)
        a(:size(on), n + j, i) = -by_state(j)*on
        if (one%sticks(j)) cycle
        a(n + j, :size(on), i) = slopes(j)*rate_by
        a(n + j, n + j, i) = by_z(j)*v(i)
      end do
    end do
  end subroutine add_element

  !> Eigenvalues without the states that stick.
  subroutine take_roots(y, n, elements, half_wave, roots, found)
    real(wp), intent(in) :: y(:, :)
    integer, intent(in) :: n
    type(element_along), intent(in) :: elements(:)
    logical, intent(in) :: half_wave
    complex(wp), allocatable, intent(out) :: roots(:)
    logical, intent(out) :: found
    integer, allocatable :: places(:)
    logical :: counts(size(y, 1))
    integer :: i, at

    counts = .true.
    at = n
    do i = 1, size(elements)
      counts(at + 1:at + size(elements(i)%z)) = .not. elements(i)%sticks
      at = at + size(elements(i)%z)
    end do
    allocate (places(count(counts)), roots(count(counts)))
    places(:) = pack([(i, i=1, size(y, 1))], counts)
    call eigenvalues(merge(-1.0_wp, 1.0_wp, half_wave)*y(places, places), roots, found)
    call sort_falling(roots, abs(roots))
  end subroutine take_roots

end module viscovib_kinked_stability
