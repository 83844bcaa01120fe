!> What the motion of third order leaves over in the equations themselves, and the motion that
!! this calls for: an estimate of the error from what is known after the fact.
!!
!! Amplitudes kept, the motion is a function of the angles of its generators; with their
!! derivatives by the modulation equations it is put into the full equations, all degrees, at
!! the points of a lattice over these angles. The residual's waves E_h exp(i h.theta), orders
!! |h| <= 4, give
!!
!!   L(s_h) U_h + sum_j g_jh L[s_h, s_j] r_j = -E_h
!!
!! as the waves of the expansion do: a motion U_h where no mode is near, a change g_jh of the
!! mode's amplitude where one is. Memory acts on a wave whose amplitude changes slowly by
!! (1 - R)(s_h) and its first two derivatives.
module viscovib_motion_defect
  use viscovib_kinds, only: wp
  use viscovib_multiple_scales, only: multiple_scales_type
  use viscovib_polynomial_form, only: full_system_type
  implicit none
  private

  public :: defect_type, find_defect

  integer, parameter :: highest_order = 4, max_angles = 6
  !> Points k (1, g, g^2, ...)/n turns, k = 0, ..., n - 1, for each number of angles: the fewest
  !! for which waves of orders |h| <= 4 are told apart (those of 1 from all up to 7), by search.
  integer, parameter :: lattice_points(0:max_angles) = [1, 20, 41, 147, 435, 1023, 2285], &
                        lattice_steps(0:max_angles) = [1, 1, 9, 19, 41, 29, 787]
  real(wp), parameter :: two_pi = 6.283185307179586_wp, same = 1.0e-9_wp

  !> In natural units, a column a wave; of each wave and its conjugate the one that does not
  !! turn backwards.
  type :: defect_type
    integer :: n = 0
    !> False: more angles than are sampled, nothing is known.
    logical :: known = .true.
    real(wp), allocatable :: frequency(:)
    !> U_h, shape (n, n_waves), and g_jh, shape (n_modes, n_waves).
    complex(wp), allocatable :: u(:, :), rates(:, :)
  end type defect_type

  !> Angles of the generators: their number, frequencies, growth of what turns with them, and
  !! whose they are; 0: does not turn.
  type :: angles_type
    integer :: n = 0
    real(wp) :: frequency(12) = 0.0_wp, growth(12) = 0.0_wp
    integer, allocatable :: of_mode(:), of_load(:)
  end type angles_type

contains

  subroutine find_defect(scales, full, a, defect)
    type(multiple_scales_type), intent(in) :: scales
    !> The system itself, in the caller's units; not allocated: the form is all of it.
    class(full_system_type), intent(in), optional :: full
    !> Amplitudes in natural units and the frame.
    complex(wp), intent(in) :: a(:)
    type(defect_type), intent(out) :: defect
    type(angles_type) :: angles
    real(wp), allocatable :: y(:, :, :), load(:, :), e(:, :), w(:, :, :)
    integer, allocatable :: orders(:, :)
    integer :: step(max_angles), n, i

    call find_angles(scales, a, angles)
    defect%known = angles%n <= max_angles
    if (.not. defect%known) return
    n = lattice_points(angles%n)
    step(1) = 1
    do i = 2, max_angles
      step(i) = modulo(step(i - 1)*lattice_steps(angles%n), n)
    end do
    associate (form => scales%form)
      allocate (y(n, form%n, 0:2), load(n, size(form%drives)), e(n, form%n), &
                w(n, form%n, 2))
      call sample_motion(scales, angles, step, a, y, load)
      call evaluate_sides(scales, full, y, load, e)
      if (form%has_memory()) call slow_sides(scales, y, w)
    end associate
    call list_orders(angles%n, orders)
    call answer_waves(scales, angles, step, orders, y, e, w, defect)
  end subroutine find_defect

  !> A load that turns with a mode shares its angle, and all that have one frequency do.
  subroutine find_angles(scales, a, angles)
    type(multiple_scales_type), intent(in) :: scales
    complex(wp), intent(in) :: a(:)
    type(angles_type), intent(out) :: angles
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

  !> All unknowns and two derivatives at the points of the lattice.
  subroutine sample_motion(scales, angles, step, a, y, load)
    type(multiple_scales_type), intent(in) :: scales
    type(angles_type), intent(in) :: angles
    integer, intent(in) :: step(:)
    complex(wp), intent(in) :: a(:)
    real(wp), intent(out) :: y(:, :, 0:), load(:, :)
    complex(wp) :: g(2*scales%normal%n_generators, 0:2), wave(size(load, 2), 0:2), p(0:2)
    complex(wp) :: turn(max_angles)
    integer :: k, i, d, points
    integer, allocatable :: pairs(:), triples(:)

    points = size(y, 1)
    associate (normal => scales%normal)
      call find_worthwhile(normal%u_pair, normal%pair, pairs)
      call find_worthwhile(normal%u_triple, normal%triple, triples)
      do k = 1, points
        do i = 1, angles%n
          turn(i) = exp(cmplx(0.0_wp, two_pi*modulo((k - 1)*step(i), points)/points, wp))
        end do
        call generators_at(scales, angles, turn, a, g, wave)
        load(k, :) = real(wave(:, 0))
        y(k, :, :) = 0.0_wp
        do i = 1, normal%n_generators
          do d = 0, 2
            y(k, :, d) = y(k, :, d) + 2.0_wp*real(normal%right(:, i)*g(i, d))
          end do
        end do
        do i = 1, size(normal%weak)
          do d = 0, 2
            y(k, :, d) = y(k, :, d) + 2.0_wp*real(normal%u_load(:, normal%weak(i)) &
                                                  *wave(normal%weak(i), d))
          end do
        end do
        do i = 1, size(pairs)
          p = product_of(g(normal%pair(1, pairs(i)), :), g(normal%pair(2, pairs(i)), :))
          do d = 0, 2
            y(k, :, d) = y(k, :, d) + real(normal%u_pair(:, pairs(i))*p(d))
          end do
        end do
        do i = 1, size(triples)
          associate (f => normal%triple(:, triples(i)))
            p = product_of(product_of(g(f(1), :), g(f(2), :)), g(f(3), :))
          end associate
          do d = 0, 2
            y(k, :, d) = y(k, :, d) + real(normal%u_triple(:, triples(i))*p(d))
          end do
        end do
      end do
    end associate

  contains

    !> Products that are there at all, of modes that move.
    subroutine find_worthwhile(u, factors, which)
      complex(wp), intent(in) :: u(:, :)
      integer, intent(in) :: factors(:, :)
      integer, allocatable, intent(out) :: which(:)
      logical :: wanted(size(u, 2)), moves(2*scales%normal%n_generators)
      integer :: q
      moves = .true.
      associate (n => size(a), m => scales%normal%n_generators)
        moves(:n) = abs(a) > 0.0_wp
        moves(m + 1:m + n) = moves(:n)
      end associate
      do q = 1, size(u, 2)
        wanted(q) = all(moves(factors(:, q))) .and. any(abs(u(:, q)) > 0.0_wp)
      end do
      which = pack([(q, q=1, size(u, 2))], wanted)
    end subroutine find_worthwhile

  end subroutine sample_motion

  !> Product of two, and its derivatives (Leibniz).
  pure function product_of(f, g) result(p)
    complex(wp), intent(in) :: f(0:), g(0:)
    complex(wp) :: p(0:2)
    p = [f(0)*g(0), f(1)*g(0) + f(0)*g(1), f(2)*g(0) + 2.0_wp*f(1)*g(1) + f(0)*g(2)]
  end function product_of

  !> Generators, waves of the loads, and their first two derivatives by the modulation
  !! equations Y_j' = s_j Y_j + sum g_jM Y_M + ...
  pure subroutine generators_at(scales, angles, turn, a, g, wave)
    type(multiple_scales_type), intent(in) :: scales
    type(angles_type), intent(in) :: angles
    complex(wp), intent(in) :: turn(:), a(:)
    complex(wp), intent(out) :: g(:, 0:), wave(:, 0:)
    complex(wp) :: factor(0:2)
    integer :: d, i, j, k, m, n, q

    n = size(a)
    m = scales%normal%n_generators
    associate (form => scales%form)
      do k = 1, size(wave, 1)
        wave(k, 0) = (1.0_wp, 0.0_wp)
        if (angles%of_load(k) > 0) wave(k, 0) = turn(angles%of_load(k))
        wave(k, 1) = cmplx(0.0_wp, form%drives(k), wp)*wave(k, 0)
        wave(k, 2) = cmplx(0.0_wp, form%drives(k), wp)*wave(k, 1)
      end do
    end associate
    g = (0.0_wp, 0.0_wp)
    do j = 1, n
      if (angles%of_mode(j) > 0) g(j, 0) = a(j)*turn(angles%of_mode(j))
    end do
    g(n + 1:m, :) = wave(scales%normal%hard, :)
    ! Each derivative from the one before.
    do d = 1, 2
      g(:n, d) = scales%flow%s*g(:n, d - 1)
      do i = 1, size(scales%flow%terms)
        associate (t => scales%flow%terms(i))
          factor = [t%coefficient, (0.0_wp, 0.0_wp), (0.0_wp, 0.0_wp)]
          do q = 1, 3
            if (t%at(q) > 0) factor = product_of(factor, g(t%at(q), :))
            if (t%at(q) < 0) factor = product_of(factor, conjg(g(-t%at(q), :)))
            if (t%loads(q) > 0) factor = product_of(factor, wave(t%loads(q), :))
            if (t%loads(q) < 0) factor = product_of(factor, conjg(wave(-t%loads(q), :)))
          end do
          g(t%row, d) = g(t%row, d) + factor(d - 1)
        end associate
      end do
    end do
    g(m + 1:, :) = conjg(g(:m, :))
  end subroutine generators_at

  !> Of equations without kernel the whole residual; of the others what memory acts on.
  subroutine evaluate_sides(scales, full, y, load, e)
    type(multiple_scales_type), intent(in) :: scales
    class(full_system_type), intent(in), optional :: full
    real(wp), intent(in), contiguous :: y(:, :, 0:), load(:, :)
    real(wp), intent(out), contiguous :: e(:, :)
    real(wp), allocatable :: own(:, :, :)
    complex(wp) :: x(scales%form%n_arguments)
    integer :: i, k

    associate (form => scales%form)
      if (present(full)) then
        allocate (own(size(y, 1), form%n, 0:2))
        do i = 1, form%n
          own(:, i, :) = scales%columns(i)*y(:, i, :)
        end do
        call full%sides(own, load, e)
        do i = 1, form%n
          e(:, i) = scales%rows(i)*e(:, i)
        end do
        return
      end if
      do k = 1, size(y, 1)
        do i = 1, form%n_arguments
          x(i) = y(k, form%source(i), form%derivative(i))
        end do
        e(k, :) = matmul(form%hereditary, y(k, :, 0)) &
                  + real(form%quadratic_at(x, x) + form%cubic_at(x, x, x))
        where (form%kernel_of == 0) e(k, :) = e(k, :) + matmul(form%linear(:, :, 0), y(k, :, 0)) &
          + matmul(form%linear(:, :, 1), y(k, :, 1)) + matmul(form%linear(:, :, 2), y(k, :, 2)) &
          - matmul(form%load, load(k, :))
      end do
    end associate
  end subroutine evaluate_sides

  !> First and second derivative of what memory acts on, to the third degree.
  subroutine slow_sides(scales, y, w)
    type(multiple_scales_type), intent(in) :: scales
    real(wp), intent(in), contiguous :: y(:, :, 0:)
    real(wp), intent(out), contiguous :: w(:, :, :)
    complex(wp) :: x(scales%form%n_arguments, 0:2)
    integer :: k, d

    associate (form => scales%form)
      do k = 1, size(y, 1)
        ! Memory acts on terms of the unknowns themselves.
        do d = 0, 2
          x(:, d) = y(k, form%source, d)
        end do
        w(k, :, 1) = matmul(form%hereditary, y(k, :, 1)) &
                     + real(2.0_wp*form%quadratic_at(x(:, 0), x(:, 1)) &
                            + 3.0_wp*form%cubic_at(x(:, 0), x(:, 0), x(:, 1)))
        w(k, :, 2) = matmul(form%hereditary, y(k, :, 2)) &
                     + real(2.0_wp*(form%quadratic_at(x(:, 0), x(:, 2)) &
                                    + form%quadratic_at(x(:, 1), x(:, 1))) &
                            + 3.0_wp*(form%cubic_at(x(:, 0), x(:, 0), x(:, 2)) &
                                      + 2.0_wp*form%cubic_at(x(:, 0), x(:, 1), x(:, 1))))
      end do
    end associate
  end subroutine slow_sides

  !> h with |h| <= 4, of each pair h, -h one.
  subroutine list_orders(m, orders)
    integer, intent(in) :: m
    integer, allocatable, intent(out) :: orders(:, :)
    integer :: h(max_angles), n, pass

    h = 0
    ! Counted first.
    do pass = 1, 2
      n = 0
      call place(1, highest_order)
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
        ! The first that is not 0 is positive.
        if (value < 0 .and. all(h(:i - 1) == 0)) cycle
        h(i) = value
        call place(i + 1, left - abs(value))
      end do
      h(i) = 0
    end subroutine place

  end subroutine list_orders

  subroutine answer_waves(scales, angles, step, orders, y, e, w, defect)
    type(multiple_scales_type), intent(in) :: scales
    type(angles_type), intent(in) :: angles
    integer, intent(in) :: step(:), orders(:, :)
    real(wp), intent(in) :: y(:, :, 0:), e(:, :), w(:, :, :)
    type(defect_type), intent(inout) :: defect
    complex(wp) :: root(0:size(y, 1) - 1), rates(2*scales%normal%n_generators)
    complex(wp) :: waves(scales%form%n), s
    real(wp) :: frequency, slowest
    integer :: points, i, k
    logical :: singular

    points = size(y, 1)
    defect%n = size(orders, 2)
    allocate (defect%frequency(defect%n), defect%u(scales%form%n, defect%n), &
              defect%rates(scales%flow%n_modes, defect%n))
    root = [(exp(cmplx(0.0_wp, -two_pi*k/points, wp)), k=0, points - 1)]/points
    ! The mean of a kernel without integral is taken where it exists.
    slowest = 1.0e-6_wp*maxval(abs(scales%flow%s))
    do i = 1, defect%n
      associate (h => orders(:, i))
        frequency = sum(h(:angles%n)*angles%frequency(:angles%n))
        call take_waves(merge(1, -1, frequency >= 0.0_wp)*h)
      end associate
      frequency = abs(frequency)
      s = cmplx(0.0_wp, frequency, wp)
      if (scales%form%has_memory()) s = cmplx(0.0_wp, max(frequency, slowest), wp)
      call scales%normal%answer(scales%form, s, frequency, -waves, defect%u(:, i), rates, singular)
      defect%frequency(i) = frequency
      defect%rates(:, i) = rates(:scales%flow%n_modes)
      ! A stiffness that vanishes: no finite motion answers.
      if (singular .and. any(abs(waves) > 0.0_wp)) defect%known = .false.
      ! The mean has no conjugate beside it.
      if (all(orders(:, i) == 0)) defect%u(:, i) = 0.5_wp*defect%u(:, i)
    end do

  contains

    subroutine take_waves(h)
      integer, intent(in) :: h(:)
      complex(wp) :: phase(points), first(scales%form%n), second(scales%form%n), at
      complex(wp) :: a_part(scales%form%n), retained(scales%form%n)
      integer :: turn, row
      turn = modulo(sum(h(:angles%n)*step(:angles%n)), points)
      phase = [(root(modulo(k*turn, points)), k=0, points - 1)]
      do row = 1, scales%form%n
        waves(row) = sum(phase*e(:, row))
      end do
      associate (form => scales%form)
        if (.not. form%has_memory()) return
        at = cmplx(sum(abs(h(:angles%n))*angles%growth(:angles%n)), &
                   max(abs(frequency), slowest), wp)
        retained = form%retained(at)
        a_part = (0.0_wp, 0.0_wp)
        do row = 1, form%n
          first(row) = sum(phase*w(:, row, 1)) - at*waves(row)
          second(row) = sum(phase*w(:, row, 2)) - 2.0_wp*at*sum(phase*w(:, row, 1)) &
                        + at**2*waves(row)
          a_part = a_part + form%linear(:, row, 0)*sum(phase*y(:, row, 0)) &
                   + form%linear(:, row, 1)*sum(phase*y(:, row, 1)) &
                   + form%linear(:, row, 2)*sum(phase*y(:, row, 2))
        end do
        if (.not. frequency*frequency > 0.0_wp) then
          first = (0.0_wp, 0.0_wp)
          second = (0.0_wp, 0.0_wp)
        else
          first = first*form%retained_between([at, at])
          second = second*form%retained_between([at, at, at])
        end if
        where (form%kernel_of > 0) waves = a_part + retained*waves + first + second
      end associate
    end subroutine take_waves

  end subroutine answer_waves

end module viscovib_motion_defect
