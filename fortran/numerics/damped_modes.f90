!> All modes of M u'' + C u' + K u = 0 with a damping that couples the undamped modes.
!!
!!   (M s^2 + C s + K)^-1 = sum_l left_l right_l^T/(s - poles_l),
!!   left_l = x,  right_l = y/(y^T Q'(s) x)
!!
!! with right and left vectors x and y of Q(s) = M s^2 + C s + K at each simple pole (Tisseur and
!! Meerbergen, The quadratic eigenvalue problem, SIAM Rev. 43 (2001) 235). Poles are eigenvalues of
!! the companion matrix, corrected by Newton's method; the vectors are the largest column and row of
!! Q^-1 near a pole. Rounding errors are then relative to the stiffest mode. Newton's method with
!! residuals in twice the precision removes them.
module viscovib_damped_modes
  use, intrinsic :: iso_fortran_env, only: real128
  use viscovib_dense, only: factorize, invert, solve, solve_complex
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: find_damped_modes

  !> Distance from a pole, in units of rounding, and number of corrections of it.
  real(wp), parameter :: nearby = 8.0_wp*epsilon(1.0_wp)
  integer, parameter :: passes = 3
  !> Changes whose square is rounding, and number of refinements.
  real(wp), parameter :: small = 1.0e-8_wp
  integer, parameter :: refining = 8
  !> Largest correction of a pole, relative to the distance of the next pole.
  real(wp), parameter :: near = 0.1_wp
  !> Allowed error of the sums over all modes, compared with M^-1 and 0.
  real(wp), parameter :: missed = 1.0e-7_wp

contains

  pure subroutine find_damped_modes(mass, damping, stiffness, poles, left, right, found, low, &
                                    roughly)
    !> Shape (n, n); the mass is not singular.
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    !> Shapes (2 n) and (n, 2 n); conjugates are adjacent.
    complex(wp), intent(out) :: poles(:), left(:, :), right(:, :)
    !> False if poles coincide without separate vectors: then there is no such sum.
    logical, intent(out) :: found
    !> Rounding errors of the stiffness entries; absent: 0.
    real(wp), intent(in), optional :: low(:, :)
    !> If true, modes keep rounding errors relative to the stiffest mode, which is much faster.
    logical, intent(in), optional :: roughly
    logical :: rough
    real(wp) :: companion(size(poles), size(poles)), inverse(size(mass, 1), size(mass, 1))
    real(wp) :: factors(size(mass, 1), size(mass, 1))
    integer :: pivots(size(mass, 1)), i, n
    logical :: singular

    n = size(mass, 1)
    rough = .false.
    if (present(roughly)) rough = roughly
    left = (0.0_wp, 0.0_wp)
    right = (0.0_wp, 0.0_wp)
    factors = mass
    call factorize(n, factors, pivots, singular)
    found = .not. singular
    poles = (0.0_wp, 0.0_wp)
    if (singular) return
    companion = 0.0_wp
    inverse = 0.0_wp
    do i = 1, n
      inverse(i, i) = 1.0_wp
      companion(i, n + i) = 1.0_wp
      call solve(n, factors, pivots, inverse(:, i))
    end do
    companion(n + 1:, :n) = -matmul(inverse, stiffness)
    companion(n + 1:, n + 1:) = -matmul(inverse, damping)
    call eigenvalues(companion, poles, found)
    if (.not. found) return
    i = 1
    do while (i <= 2*n)
      if (rough) then
        call iterate_vectors(mass, damping, stiffness, poles(i), left(:, i), right(:, i), found)
      else
        call find_vectors(mass, damping, stiffness, maxval(abs(poles)), poles(i), left(:, i), &
                          right(:, i), found)
      end if
      if (.not. found) return
      if (abs(aimag(poles(i))) > 0.0_wp .and. i < 2*n) then
        poles(i + 1) = conjg(poles(i))
        left(:, i + 1) = conjg(left(:, i))
        right(:, i + 1) = conjg(right(:, i))
        i = i + 1
      end if
      i = i + 1
    end do
    if (.not. rough) call refine(mass, damping, stiffness, poles, left, right, low)
    call check_sums(inverse, poles, left, right, found)
  end subroutine find_damped_modes

  pure subroutine find_vectors(mass, damping, stiffness, largest, pole, x, y, found)
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :), largest
    complex(wp), intent(inout) :: pole
    complex(wp), intent(out) :: x(:), y(:)
    logical, intent(out) :: found
    complex(wp), dimension(size(x), size(x)) :: q, inverse
    complex(wp) :: slope, s
    real(wp) :: off
    integer :: pass
    logical :: singular, real_pole

    real_pole = .not. abs(aimag(pole)) > 0.0_wp
    x = (0.0_wp, 0.0_wp)
    y = (0.0_wp, 0.0_wp)
    do pass = 1, passes
      off = nearby*max(abs(pole), epsilon(1.0_wp)*largest)
      do
        s = pole + off
        q = mass*s**2 + damping*s + stiffness
        call invert(q, inverse, singular)
        found = .not. singular
        if (found) found = maxval(abs(inverse)) <= huge(1.0_wp)
        if (found .or. off > 1.0e-6_wp*largest) exit
        off = 16.0_wp*off
      end do
      if (.not. found) return
      x = inverse(:, maxloc(maxval(abs(inverse), 1), 1))
      x = x/maxval(abs(x))
      y = inverse(maxloc(maxval(abs(inverse), 2), 1), :)
      y = y/maxval(abs(y))
      slope = sum(y*matmul(2.0_wp*s*mass + damping, x))
      found = abs(slope) > 0.0_wp
      if (.not. found) return
      if (pass == passes) exit
      q = mass*pole**2 + damping*pole + stiffness
      pole = pole - sum(y*matmul(q, x))/slope
      if (real_pole) pole = real(pole)
    end do
    y = y/slope
    if (real_pole) then
      x = real(x)
      y = real(y)
    end if
  end subroutine find_vectors

  !> As `find_vectors`, by inverse iteration.
  pure subroutine iterate_vectors(mass, damping, stiffness, pole, x, y, found)
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    complex(wp), intent(inout) :: pole
    complex(wp), intent(out) :: x(:), y(:)
    logical, intent(out) :: found
    complex(wp) :: q(size(x), size(x)), slope
    integer :: i, pass
    logical :: real_pole, singular

    real_pole = .not. abs(aimag(pole)) > 0.0_wp
    ! Arbitrary vectors, so that no mode is orthogonal to them.
    x = [(cmplx(cos(1.7_wp*i), merge(0.0_wp, sin(2.3_wp*i), real_pole), wp), i=1, size(x))]
    y = x
    do pass = 1, 2
      q = mass*pole**2 + damping*pole + stiffness
      call solve_complex(q, x, .true., singular)
      found = .not. singular
      if (found) call solve_complex(transpose(q), y, .true., singular)
      found = found .and. .not. singular .and. maxval(abs(x)) <= huge(1.0_wp) &
              .and. maxval(abs(y)) <= huge(1.0_wp)
      if (.not. found) return
      x = x/maxval(abs(x))
      y = y/maxval(abs(y))
      slope = sum(y*matmul(2.0_wp*pole*mass + damping, x))
      found = abs(slope) > 0.0_wp
      if (.not. found) return
      if (pass == 1) pole = pole - sum(y*matmul(q, x))/slope
      if (real_pole) pole = real(pole)
    end do
    y = y/slope
  end subroutine iterate_vectors

  !> Refine the modes to the precision of the entries, each separately by Newton's method:
  !!
  !!   [Q(s)       Q'(s) x] [dx]     [Q(s) x]        [Q(s)^T     Q'(s)^T y] [dy]     [Q(s)^T y]
  !!   [y^T Q'(s)     0   ] [ds] = - [  0   ],       [x^T Q'(s)^T    0    ] [ds] = - [   0    ]
  !!
  !! (Peters and Wilkinson, SIAM Rev. 21 (1979) 339). The residuals Q x and Q^T y have twice the
  !! precision; a few digits of the inverse are enough. A pole that would approach another is kept.
  pure subroutine refine(mass, damping, stiffness, poles, left, right, low)
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    complex(wp), intent(inout) :: poles(:), left(:, :), right(:, :)
    real(wp), intent(in), optional :: low(:, :)
    complex(wp) :: found(size(poles))
    real(wp) :: reach
    integer :: i, k

    found = poles
    do i = 1, size(poles)
      if (aimag(poles(i)) < 0.0_wp) cycle
      reach = near*minval(abs(poles - poles(i)), mask=[(k /= i, k=1, size(poles))])
      call refine_one(mass, damping, stiffness, reach, found(i), left(:, i), right(:, i), low)
      if (.not. aimag(poles(i)) > 0.0_wp) cycle
      found(i + 1) = conjg(found(i))
      left(:, i + 1) = conjg(left(:, i))
      right(:, i + 1) = conjg(right(:, i))
    end do
    poles = found
  end subroutine refine

  pure subroutine refine_one(mass, damping, stiffness, reach, pole, x, y, low)
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    !> Largest change of the pole.
    real(wp), intent(in) :: reach
    !> With y^T Q'(pole) x = 1.
    complex(wp), intent(inout) :: pole, x(:), y(:)
    real(wp), intent(in), optional :: low(:, :)
    complex(wp), dimension(size(x) + 1, size(x) + 1) :: bordered, inverse
    complex(wp), dimension(size(x)) :: better_x, better_y
    complex(wp), dimension(size(x) + 1) :: x_left, y_left
    complex(wp) :: s, slope
    real(wp) :: change, last
    integer :: n, pass
    logical :: singular, real_pole

    n = size(x)
    real_pole = .not. abs(aimag(pole)) > 0.0_wp
    s = pole
    better_x = x
    better_y = y
    last = 1.0_wp
    do pass = 1, refining
      call look(mass, damping, stiffness, s, better_x, better_y, x_left, y_left, &
                bordered(:n, n + 1), bordered(n + 1, :n), slope, low)
      better_y = better_y/slope
      if (last < small) exit
      bordered(:n, :n) = mass*s**2 + damping*s + stiffness
      bordered(n + 1, n + 1) = (0.0_wp, 0.0_wp)
      call invert(bordered, inverse, singular)
      if (singular) return
      x_left = matmul(inverse, x_left)
      y_left = matmul(y_left/slope, inverse)
      change = max(maxval(abs(x_left(:n)))/maxval(abs(better_x)), &
                   maxval(abs(y_left(:n)))/maxval(abs(better_y)))
      ! Useless if not even the first digits of the inverse are correct.
      if (.not. change < last) return
      last = change
      s = s - x_left(n + 1)
      if (real_pole) s = real(s)
      if (.not. abs(s - pole) <= reach) return
      better_x = better_x - x_left(:n)
      better_y = better_y - y_left(:n)
    end do
    if (.not. last < small) return
    pole = s
    x = better_x
    y = better_y
    if (real_pole) then
      x = real(x)
      y = real(y)
    end if
  end subroutine refine_one

  !> Q x and Q^T y, Q' x and Q'^T y, y^T Q' x, in twice the precision.
  pure subroutine look(mass, damping, stiffness, s, x, y, x_left, y_left, x_slope, y_slope, slope, &
                       low)
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    complex(wp), intent(in) :: s, x(:), y(:)
    !> Each followed by a 0, shape (n + 1).
    complex(wp), intent(out) :: x_left(:), y_left(:)
    complex(wp), intent(out) :: x_slope(:), y_slope(:), slope
    real(wp), intent(in), optional :: low(:, :)
    complex(real128), dimension(size(x)) :: qx, qy, dx, dy
    complex(real128) :: q, d, t
    integer :: i, j

    t = s
    qx = (0.0_real128, 0.0_real128)
    qy = qx
    dx = qx
    dy = qx
    do j = 1, size(x)
      do i = 1, size(x)
        if (.not. any(abs([mass(i, j), damping(i, j), stiffness(i, j)]) > 0.0_wp)) cycle
        d = t*mass(i, j) + damping(i, j)
        q = t*d + stiffness(i, j)
        d = d + t*mass(i, j)
        qx(i) = qx(i) + q*x(j)
        qy(j) = qy(j) + q*y(i)
        dx(i) = dx(i) + d*x(j)
        dy(j) = dy(j) + d*y(i)
      end do
    end do
    if (present(low)) then
      do j = 1, size(x)
        qx = qx + real(low(:, j), real128)*x(j)
        qy(j) = qy(j) + sum(real(low(:, j), real128)*y)
      end do
    end if
    x_left = [cmplx(qx, kind=wp), (0.0_wp, 0.0_wp)]
    y_left = [cmplx(qy, kind=wp), (0.0_wp, 0.0_wp)]
    x_slope = cmplx(dx, kind=wp)
    y_slope = cmplx(dy, kind=wp)
    slope = cmplx(sum(dx*y), kind=wp)
  end subroutine look

  !> For large s, s^2 Q^-1 is M^-1: sum left right^T = 0 and sum poles left right^T = M^-1.
  pure subroutine check_sums(inverse, poles, left, right, found)
    real(wp), intent(in) :: inverse(:, :)
    complex(wp), intent(in) :: poles(:), left(:, :), right(:, :)
    logical, intent(out) :: found
    complex(wp) :: weighed(size(left, 1), size(left, 2))
    real(wp) :: sizes(size(inverse, 1), size(inverse, 1)), largest
    integer :: i

    largest = maxval(abs(inverse))
    do i = 1, size(poles)
      weighed(:, i) = left(:, i)*poles(i)
    end do
    sizes = abs(matmul(weighed, transpose(right)) - inverse)
    found = maxval(sizes) <= missed*largest
    sizes = abs(matmul(left, transpose(right)))
    found = found .and. maxval(sizes)*maxval(abs(poles)) <= missed*largest
  end subroutine check_sums

end module viscovib_damped_modes
