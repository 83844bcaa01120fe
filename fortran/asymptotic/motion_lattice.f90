! Optimize: -O2 -fvect-cost-model=dynamic
!> The motion of third order as a function of the angles of its generators, at the points of a
!! lattice: the moduli of the generators are constant, and each angle is a free variable. Time
!! derivatives follow from the modulation equations.
module viscovib_motion_lattice
  use viscovib_kinds, only: wp
  use viscovib_multiple_scales, only: multiple_scales_type
  use viscovib_slow_flow, only: flow_term_type
  implicit none
  private

  public :: angles_type, find_angles, lattice_of, list_orders, sample_change, sample_generators, &
    sample_motion

  integer, parameter, public :: max_angles = 6, highest_order = 4
  !> Points k (1, g, g^2, ...)/n turns, k = 0, ..., n - 1, for each number of angles: the smallest n
  !! that distinguishes terms of orders |h| <= 4 (terms of order 1 from all up to 7), by search.
  integer, parameter :: lattice_points(0:max_angles) = [1, 20, 41, 147, 435, 1023, 2285], &
                        lattice_steps(0:max_angles) = [1, 1, 9, 19, 41, 29, 787]
  real(wp), parameter :: two_pi = 6.283185307179586_wp, same = 1.0e-9_wp

  !> Angles of the generators: their number, the frequencies of the frame, the total frequencies of
  !! the generators, the growth of these generators, and the mode or load of each angle; 0: the
  !! generator has no angle.
  type :: angles_type
    integer :: n = 0
    real(wp) :: frequency(12) = 0.0_wp, whole(12) = 0.0_wp, growth(12) = 0.0_wp
    integer, allocatable :: of_mode(:), of_load(:)
  end type angles_type

contains

  !> Number of points, and the increments of the angles between points, in units of 2 pi/points.
  pure subroutine lattice_of(n_angles, points, step)
    integer, intent(in) :: n_angles
    integer, intent(out) :: points, step(max_angles)
    integer :: i
    points = lattice_points(n_angles)
    step(1) = 1
    do i = 2, max_angles
      step(i) = modulo(step(i - 1)*lattice_steps(n_angles), points)
    end do
  end subroutine lattice_of

  !> A load at the frequency of a mode shares its angle; loads of equal frequency share one.
  subroutine find_angles(scales, a, angles, turns)
    type(multiple_scales_type), intent(in) :: scales
    complex(wp), intent(in) :: a(:)
    type(angles_type), intent(out) :: angles
    !> Mean frequencies of the amplitudes in their frame; default 0.
    real(wp), intent(in), optional :: turns(:)
    integer :: j, k

    associate (form => scales%form, frame => scales%flow%frame)
      allocate (angles%of_mode(size(a)), angles%of_load(size(form%drives)), source=0)
      do j = 1, size(a)
        if (.not. abs(a(j)) > 0.0_wp) cycle
        angles%of_mode(j) = angle_of(frame(j))
        if (.not. scales%normal%steady) then
          angles%growth(angles%of_mode(j)) = real(scales%flow%s(j))
        end if
      end do
      do k = 1, size(form%drives)
        if (any(abs(form%load(:, k)) > 0.0_wp)) angles%of_load(k) = angle_of(form%drives(k))
      end do
      angles%whole = angles%frequency
      if (.not. present(turns)) return
      do j = 1, size(a)
        ! A shared angle has the frequency of that load or mode.
        if (angles%of_mode(j) == 0 .or. any(angles%of_load == angles%of_mode(j)) &
            .or. count(angles%of_mode == angles%of_mode(j)) > 1) cycle
        angles%whole(angles%of_mode(j)) = frame(j) + turns(j)
      end do
    end associate

  contains

    integer function angle_of(frequency)
      real(wp), intent(in) :: frequency
      angle_of = 0
      if (.not. frequency > 0.0_wp) return
      do angle_of = 1, angles%n
        if (abs(angles%frequency(angle_of) - frequency) <= same*frequency) return
      end do
      angles%n = angles%n + 1
      angles%frequency(angles%n) = frequency
    end function angle_of

  end subroutine find_angles

  !> Generators, terms exp(i p t) of the loads, and their first two derivatives by the modulation
  !! equations Y_j' = s_j Y_j + sum g_jM Y_M + ..., at the points of the lattice.
  subroutine sample_generators(scales, angles, step, a, g, wave)
    type(multiple_scales_type), intent(in) :: scales
    type(angles_type), intent(in) :: angles
    integer, intent(in) :: step(:)
    complex(wp), intent(in) :: a(:)
    !> Shapes (n_points, 0:2, 2 n_generators) and (n_points, 0:2, n_loads).
    complex(wp), intent(out) :: g(:, 0:, :), wave(:, 0:, :)
    complex(wp) :: turn(size(g, 1), max_angles), roots(0:size(g, 1) - 1)
    integer :: i, k, points

    points = size(g, 1)
    roots = [(exp(cmplx(0.0_wp, two_pi*k/points, wp)), k=0, points - 1)]
    do i = 1, angles%n
      turn(:, i) = [(roots(modulo(k*step(i), points)), k=0, points - 1)]
    end do
    call generators_at(scales, angles, turn, a, g, wave)
  end subroutine sample_generators

  !> All unknowns and two derivatives at the points of the lattice.
  subroutine sample_motion(scales, a, g, wave, y)
    type(multiple_scales_type), intent(in) :: scales
    complex(wp), intent(in) :: a(:)
    !> As in `sample_generators`.
    complex(wp), intent(in) :: g(:, 0:, :), wave(:, 0:, :)
    real(wp), intent(out) :: y(:, :, 0:)
    complex(wp), dimension(size(y, 1), 0:2) :: of_two, part
    integer :: i, before(2)
    integer, allocatable :: pairs(:), triples(:)
    real(wp), allocatable :: of_pairs(:), of_triples(:)

    y = 0.0_wp
    associate (normal => scales%normal)
      call find_worthwhile(normal%u_pair, normal%pair, pairs, of_pairs)
      call find_worthwhile(normal%u_triple, normal%triple, triples, of_triples)
      do i = 1, normal%n_generators
        call add(g(:, :, i), 2.0_wp*normal%right(:, i), y)
      end do
      do i = 1, size(normal%weak)
        call add(wave(:, :, normal%weak(i)), 2.0_wp*normal%u_load(:, normal%weak(i)), y)
      end do
      do i = 1, size(pairs)
        associate (f => normal%pair(:, pairs(i)))
          call multiply_functions(g(:, :, f(1)), g(:, :, f(2)), part)
          call add(part, of_pairs(i)*normal%u_pair(:, pairs(i)), y)
        end associate
      end do
      before = 0
      do i = 1, size(triples)
        associate (f => normal%triple(:, triples(i)))
          ! Products with the same last two factors follow each other.
          if (any(f(2:) /= before)) then
            call multiply_functions(g(:, :, f(2)), g(:, :, f(3)), of_two)
          end if
          before = f(2:)
          call multiply_functions(g(:, :, f(1)), of_two, part)
          call add(part, of_triples(i)*normal%u_triple(:, triples(i)), y)
        end associate
      end do
    end associate

  contains

    !> Products with nonzero coefficients of active modes. Of a product and its conjugate, which
    !! adds the same real part, only the first is listed, with its weight.
    subroutine find_worthwhile(u, factors, which, times)
      complex(wp), intent(in) :: u(:, :)
      integer, intent(in) :: factors(:, :)
      integer, allocatable, intent(out) :: which(:)
      real(wp), allocatable, intent(out) :: times(:)
      logical :: wanted(size(u, 2)), moves(2*scales%normal%n_generators)
      integer :: other(size(u, 2)), q
      moves = .true.
      associate (n => size(a), m => scales%normal%n_generators)
        moves(:n) = a /= (0.0_wp, 0.0_wp)
        moves(m + 1:m + n) = moves(:n)
      end associate
      do q = 1, size(u, 2)
        wanted(q) = all(moves(factors(:, q)))
        if (wanted(q)) wanted(q) = any(u(:, q) /= (0.0_wp, 0.0_wp))
        if (.not. wanted(q)) cycle
        other(q) = scales%normal%mirror_of(factors(:, q))
        wanted(q) = other(q) >= q
      end do
      which = pack([(q, q=1, size(u, 2))], wanted)
      times = merge(1.0_wp, 2.0_wp, other(which) == which)
    end subroutine find_worthwhile

  end subroutine sample_motion

  !> Add the real part of a term with these coefficients to all unknowns and derivatives.
  pure subroutine add(wave, u, y)
    complex(wp), intent(in) :: wave(:, 0:), u(:)
    real(wp), intent(inout) :: y(:, :, 0:)
    integer :: d, row
    do d = 0, 2
      do row = 1, size(u)
        y(:, row, d) = y(:, row, d) + (real(u(row))*real(wave(:, d)) - aimag(u(row)) &
                                       *aimag(wave(:, d)))
      end do
    end do
  end subroutine add

  !> The linear change of the motion by a small amplitude b of mode j at rest, whose angle is not on
  !! the lattice: y changes by 2 Re (b exp(i angle) w), with two derivatives.
  subroutine sample_change(scales, g, wave, j, w)
    type(multiple_scales_type), intent(in) :: scales
    !> As in `sample_generators`, for the motion.
    complex(wp), intent(in) :: g(:, 0:, :), wave(:, 0:, :)
    integer, intent(in) :: j
    !> Shape (n_points, n, 0:2).
    complex(wp), intent(out) :: w(:, :, 0:)
    complex(wp) :: change(size(g, 1), 0:2, size(g, 3))
    complex(wp), dimension(size(g, 1), 0:2) :: part, two
    logical, dimension(size(g, 3)) :: moves, changes
    integer :: i, q, f(3)

    call changes_at(scales, g, wave, j, moves, changes, change)
    w = (0.0_wp, 0.0_wp)
    associate (normal => scales%normal)
      do i = 1, size(g, 3)
        if (changes(i)) call add_change(change(:, :, i), normal%right(:, i))
      end do
      ! Products with other modes at rest are left out: only their derivatives are not 0.
      moves([j, j + normal%n_generators]) = .true.
      changes = changes .and. moves
      moves([j, j + normal%n_generators]) = .false.
      do i = 1, size(normal%pair, 2)
        f(:2) = normal%pair(:, i)
        do q = 1, 2
          if (changes(f(1)) .and. moves(f(2))) then
            call multiply_functions(change(:, :, f(1)), g(:, :, f(2)), part)
            call add_change(part, normal%u_pair(:, i))
          end if
          f(:2) = [f(2), f(1)]
        end do
      end do
      do i = 1, size(normal%triple, 2)
        f = normal%triple(:, i)
        do q = 1, 3
          if (changes(f(1)) .and. moves(f(2)) .and. moves(f(3))) then
            call multiply_functions(change(:, :, f(1)), g(:, :, f(2)), two)
            call multiply_functions(two, g(:, :, f(3)), part)
            call add_change(part, normal%u_triple(:, i))
          end if
          f = [f(2), f(3), f(1)]
        end do
      end do
    end associate

  contains

    subroutine add_change(of_product, u)
      complex(wp), intent(in) :: of_product(:, 0:), u(:)
      integer :: d, row
      do d = 0, 2
        do row = 1, size(u)
          w(:, row, d) = w(:, row, d) + u(row)*of_product(:, d)
        end do
      end do
    end subroutine add_change

  end subroutine sample_change

  !> The change of each generator and its derivatives, divided by b exp(i angle).
  subroutine changes_at(scales, g, wave, j, moves, changes, change)
    type(multiple_scales_type), intent(in) :: scales
    complex(wp), intent(in) :: g(:, 0:, :), wave(:, 0:, :)
    integer, intent(in) :: j
    !> Generators that are not 0, and those that change.
    logical, intent(out) :: moves(:), changes(:)
    complex(wp), intent(out) :: change(:, 0:, :)
    !> A product and its time derivative, and the change of both; the change of a load.
    complex(wp), dimension(size(g, 1), 0:1) :: product, varied, still
    !> Generators that are 0 together with their first derivative.
    logical :: rests(size(g, 3))
    integer :: d, i, k, m

    m = scales%normal%n_generators
    do k = 1, size(moves)
      moves(k) = any(g(:, 0, k) /= (0.0_wp, 0.0_wp))
      rests(k) = .not. (moves(k) .or. any(g(:, 1, k) /= (0.0_wp, 0.0_wp)))
    end do
    still = (0.0_wp, 0.0_wp)
    changes = .false.
    changes(j) = .true.
    change = (0.0_wp, 0.0_wp)
    change(:, 0, j) = (1.0_wp, 0.0_wp)
    do d = 1, 2
      do k = 1, scales%flow%n_modes
        change(:, d, k) = scales%flow%s(k)*change(:, d - 1, k)
        change(:, d, m + k) = conjg(scales%flow%s(k))*change(:, d - 1, m + k)
      end do
      do i = 1, size(scales%flow%terms)
        call add_term(scales%flow%terms(i), mirrored=.false.)
        call add_term(scales%flow%terms(i), mirrored=.true.)
      end do
      do k = 1, size(changes)
        changes(k) = changes(k) .or. any(change(:, d, k) /= (0.0_wp, 0.0_wp))
      end do
    end do

  contains

    !> Add the change of a term, or of its conjugate, to derivative d of its generator.
    subroutine add_term(t, mirrored)
      type(flow_term_type), intent(in) :: t
      logical, intent(in) :: mirrored
      integer :: q, k, own, n_rest
      logical :: any_changes

      any_changes = .false.
      n_rest = 0
      do q = 1, 3
        if (t%at(q) == 0) cycle
        k = place_of(t%at(q), mirrored)
        any_changes = any_changes .or. changes(k)
        if (rests(k)) n_rest = n_rest + 1
      end do
      ! The change of a product of several modes at rest is 0.
      if (.not. any_changes .or. n_rest > 1) return
      product(:, 0) = merge(conjg(t%coefficient), t%coefficient, mirrored)
      product(:, 1) = (0.0_wp, 0.0_wp)
      varied = (0.0_wp, 0.0_wp)
      do q = 1, 3
        if (t%at(q) /= 0) then
          k = place_of(t%at(q), mirrored)
          call vary(product, varied, g(:, :1, k), change(:, :1, k))
        end if
        k = abs(t%loads(q))
        if (k == 0) cycle
        if ((t%loads(q) < 0) .neqv. mirrored) then
          call vary(product, varied, conjg(wave(:, :1, k)), still)
        else
          call vary(product, varied, wave(:, :1, k), still)
        end if
      end do
      own = t%row + merge(m, 0, mirrored)
      change(:, d, own) = change(:, d, own) + varied(:, d - 1)
    end subroutine add_term

    !> The generator of a factor of a term or of its conjugate.
    pure integer function place_of(at, mirrored)
      integer, intent(in) :: at
      logical, intent(in) :: mirrored
      place_of = abs(at) + merge(m, 0, (at < 0) .neqv. mirrored)
    end function place_of

  end subroutine changes_at

  !> Multiply a product and its change, each with a first derivative, by another factor.
  pure subroutine vary(product, varied, factor, change)
    complex(wp), intent(inout) :: product(:, 0:), varied(:, 0:)
    complex(wp), intent(in) :: factor(:, 0:), change(:, 0:)
    varied(:, 1) = varied(:, 1)*factor(:, 0) + varied(:, 0)*factor(:, 1) &
                   + product(:, 1)*change(:, 0) + product(:, 0)*change(:, 1)
    varied(:, 0) = varied(:, 0)*factor(:, 0) + product(:, 0)*change(:, 0)
    product(:, 1) = product(:, 1)*factor(:, 0) + product(:, 0)*factor(:, 1)
    product(:, 0) = product(:, 0)*factor(:, 0)
  end subroutine vary

  !> Product of two functions, and its derivatives (Leibniz).
  pure subroutine multiply_functions(f, g, p)
    complex(wp), intent(in) :: f(:, 0:), g(:, 0:)
    complex(wp), intent(out) :: p(:, 0:)
    p(:, 0) = f(:, 0)*g(:, 0)
    p(:, 1) = f(:, 1)*g(:, 0) + f(:, 0)*g(:, 1)
    p(:, 2) = f(:, 2)*g(:, 0) + 2.0_wp*(f(:, 1)*g(:, 1)) + f(:, 0)*g(:, 2)
  end subroutine multiply_functions

  !> Generators, terms exp(i p t) of the loads, and their first two derivatives by the modulation
  !! equations Y_j' = s_j Y_j + sum g_jM Y_M + ..., at all points.
  pure subroutine generators_at(scales, angles, turn, a, g, wave)
    type(multiple_scales_type), intent(in) :: scales
    type(angles_type), intent(in) :: angles
    complex(wp), intent(in) :: turn(:, :), a(:)
    complex(wp), intent(out) :: g(:, 0:, :), wave(:, 0:, :)
    complex(wp) :: value(size(turn, 1)), slope(size(turn, 1))
    integer :: d, i, j, k, m, n, q

    n = size(a)
    m = scales%normal%n_generators
    do k = 1, size(wave, 3)
      wave(:, 0, k) = (1.0_wp, 0.0_wp)
      if (angles%of_load(k) > 0) wave(:, 0, k) = turn(:, angles%of_load(k))
      do d = 1, 2
        wave(:, d, k) = cmplx(0.0_wp, scales%form%drives(k), wp)*wave(:, d - 1, k)
      end do
    end do
    g = (0.0_wp, 0.0_wp)
    do j = 1, n
      if (angles%of_mode(j) > 0) g(:, 0, j) = a(j)*turn(:, angles%of_mode(j))
    end do
    g(:, :, n + 1:m) = wave(:, :, scales%normal%hard)
    ! Each derivative follows from the one of lower order.
    do d = 1, 2
      do j = 1, n
        g(:, d, j) = scales%flow%s(j)*g(:, d - 1, j)
      end do
      do i = 1, size(scales%flow%terms)
        associate (t => scales%flow%terms(i))
          value = t%coefficient
          slope = (0.0_wp, 0.0_wp)
          do q = 1, 3
            if (t%at(q) > 0) call multiply(value, slope, g(:, 0, t%at(q)), g(:, 1, t%at(q)))
            if (t%at(q) < 0) call multiply(value, slope, conjg(g(:, 0, -t%at(q))), &
                                              conjg(g(:, 1, -t%at(q))))
            if (t%loads(q) > 0) call multiply(value, slope, wave(:, 0, t%loads(q)), &
                                              wave(:, 1, t%loads(q)))
            if (t%loads(q) < 0) call multiply(value, slope, conjg(wave(:, 0, -t%loads(q))), &
                                              conjg(wave(:, 1, -t%loads(q))))
          end do
          if (d == 1) g(:, d, t%row) = g(:, d, t%row) + value
          if (d == 2) g(:, d, t%row) = g(:, d, t%row) + slope
        end associate
      end do
    end do
    g(:, :, m + 1:) = conjg(g(:, :, :m))
  end subroutine generators_at

  !> Multiply a product and its first derivative by another factor.
  pure subroutine multiply(value, slope, f, f_slope)
    complex(wp), intent(inout) :: value(:), slope(:)
    complex(wp), intent(in) :: f(:), f_slope(:)
    slope = slope*f + value*f_slope
    value = value*f
  end subroutine multiply

  !> h with |h| <= highest, one of each pair h, -h.
  subroutine list_orders(m, highest, orders)
    integer, intent(in) :: m, highest
    integer, allocatable, intent(out) :: orders(:, :)
    integer :: h(max_angles), n, pass

    h = 0
    ! Count first.
    do pass = 1, 2
      n = 0
      call place(1, highest)
      if (pass == 1) allocate (orders(max_angles, n))
    end do

  contains

    recursive subroutine place(i, left)
      integer, intent(in) :: i, left
      integer :: value
      if (i > m) then
        n = n + 1
        if (pass == 2) orders(:, n) = h
        return
      end if
      do value = -left, left
        ! The first entry other than 0 is positive.
        if (value < 0 .and. all(h(:i - 1) == 0)) cycle
        h(i) = value
        call place(i + 1, left - abs(value))
      end do
      h(i) = 0
    end subroutine place

  end subroutine list_orders

end module viscovib_motion_lattice
